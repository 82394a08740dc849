"""Random delays before the studio handles a request and before it answers, to find races."""

import asyncio
import os
import random

from liaam.studio import app as studio

LIMIT = float(os.environ.get("LIAAM_DELAY", "0")) / 1000
"""Longest sum of both delays, seconds."""


class Delayed:
    """An application whose answers are late."""

    def __init__(self, app) -> None:
        self.app = app

    async def __call__(self, scope, receive, send) -> None:
        async def send_late(message) -> None:
            if message["type"] == "http.response.start":
                await asyncio.sleep(random.uniform(0, LIMIT / 2))
            await send(message)

        await asyncio.sleep(random.uniform(0, LIMIT / 2))
        await self.app(scope, receive, send_late)


def delay() -> None:
    """Make the answers of studios of this process late."""
    make_app = studio.make_app
    studio.make_app = lambda *arguments: Delayed(make_app(*arguments))
