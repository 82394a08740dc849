"""What hostile uploads cost the studio, and whom they keep waiting: ``python -m benchmarks load``.

A hundred and forty-five kilobytes of PNG that decode to 50 million pixels, bodies of 20 MB, and requests that stay half
sent, all at once, against a real ``liaam studio``, while somebody goes on looking at the project.
"""

import asyncio
import statistics
import tempfile
import time
import zlib
from collections import Counter
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from pathlib import Path
from struct import pack
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np

from benchmarks.metrics import report
from benchmarks.studio import start
from liaam.io import write_image

SIDE = 7040
"""Of a picture that may just be decoded, pixels."""

N_UPLOADS, N_LARGE, N_HALF = 200, 60, 400
"""Bombs, bodies of 20 MB, and requests that stay half sent."""

SECONDS = 40.0
"""How long it is watched at most."""


def bomb(side: int = SIDE) -> bytes:
    """PNG of a black picture, which takes next to nothing."""

    def chunk(tag: bytes, data: bytes) -> bytes:
        return pack(">I", len(data)) + tag + data + pack(">I", zlib.crc32(tag + data))

    rows = zlib.compress(bytes((1 + 3 * side) * side), 9)
    header = pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


class Client:
    """Requests to a studio, each on a connection of its own."""

    def __init__(self, address: str) -> None:
        parts = urlsplit(address)
        self.host, self.port = parts.hostname, parts.port
        self.token = parse_qs(parts.query)["token"][0]

    def head(self, target: str, method: str, length: int) -> bytes:
        """Line and headers of a request."""
        lines = (
            f"{method} {target} HTTP/1.1",
            f"Host: {self.host}:{self.port}",
            f"Authorization: Bearer {self.token}",
            f"Content-Length: {length}",
            "Connection: close",
        )
        return "\r\n".join((*lines, "", "")).encode()

    async def ask(self, target: str, method: str = "GET", body: bytes = b"", part: int | None = None) -> int:
        """Status of the answer; 0 if it hangs up without one. ``part``: bytes of head and body that are sent at all."""
        reader, writer = await asyncio.open_connection(self.host, self.port)
        try:
            writer.write((self.head(target, method, len(body)) + body)[:part])
            await writer.drain()
            answer = await reader.read()
            return int(answer.split(b" ", 2)[1]) if answer else 0
        except ConnectionError:
            return 0
        finally:
            writer.close()


def resident(process: int) -> int:
    """Resident memory of a process now, bytes."""
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * 4096


async def watch(client: Client, process: int, attacker: BaseProcess, times: list[float], memory: list[int]) -> None:
    """Ask for the project again and again while an attack lasts, and look at the memory."""
    while attacker.is_alive():
        begun = time.perf_counter()
        assert await client.ask("/api/project") == 200
        times.append(time.perf_counter() - begun)
        memory.append(resident(process))
        await asyncio.sleep(0.02)


def attack(address: str, answers: Any) -> None:
    """Send everything at once, and tell what was answered; in a process of its own, to keep nobody waiting itself."""
    answers.put(asyncio.run(storm(Client(address))))


async def storm(client: Client) -> Counter:
    """Statuses of the answers; -1 for none."""
    target, data, large = "/api/uploads?name=x.png", bomb(), bytes(20_000_000)
    attacks = [client.ask(target, "POST", data) for _ in range(N_UPLOADS)]
    attacks += [client.ask(target, "POST", large) for _ in range(N_LARGE)]
    attacks += [client.ask(target, "POST", data, (40, 400)[i % 2]) for i in range(N_HALF)]
    done, left = await asyncio.wait([asyncio.create_task(one) for one in attacks], timeout=SECONDS)
    for one in left:
        one.cancel()
    return Counter([one.result() for one in done] + [-1] * len(left))


def main() -> None:
    """Report the memory and the waits."""
    context, times, memory = get_context("spawn"), [], []
    with tempfile.TemporaryDirectory() as folder:
        write_image(Path(folder) / "p1.png", np.full((480, 640, 3), 90, np.uint8))
        server, answers = start(Path(folder)), context.Queue()
        try:
            attacker = context.Process(target=attack, args=(server.address, answers), daemon=True)
            attacker.start()
            asyncio.run(watch(Client(server.address), server.process.pid, attacker, times, memory))
        finally:
            server.stop()
    found = answers.get(timeout=10)
    print(f"answers: {dict(found)} (0: hung up, -1: none in {SECONDS:.0f} s)")
    report("studio_load_memory_mb", max(memory) / 1e6, "MB, the bar is 1500", form=".0f")
    report("studio_load_longest_wait_ms", 1000 * max(times), "ms, the bar is 1000", form=".0f")
    report("studio_load_median_wait_ms", 1000 * statistics.median(times), "ms", form=".1f")
    report("studio_load_unanswered", found[-1], form=".0f")


if __name__ == "__main__":
    main()
