"""Memory and response time of the studio under hostile uploads: ``python -m benchmarks load``.

A real ``liaam studio`` receives PNG files of 145 kB that decode to 50 million pixels, bodies of 20 MB, and incomplete
requests, all at once, while another client keeps requesting the project.
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
"""Side in pixels of the largest image that may be decoded."""

N_UPLOADS, N_LARGE, N_HALF = 200, 60, 400
"""Numbers of decompression bombs, bodies of 20 MB, and incomplete requests."""

SECONDS = 40.0
"""Maximum duration of the measurement."""


def bomb(side: int = SIDE) -> bytes:
    """Make a PNG of a black image, which is tiny."""

    def chunk(tag: bytes, data: bytes) -> bytes:
        return pack(">I", len(data)) + tag + data + pack(">I", zlib.crc32(tag + data))

    rows = zlib.compress(bytes((1 + 3 * side) * side), 9)
    header = pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


class Client:
    """Requests to a studio, each on a separate connection."""

    def __init__(self, address: str) -> None:
        parts = urlsplit(address)
        self.host, self.port = parts.hostname, parts.port
        self.token = parse_qs(parts.query)["token"][0]

    def head(self, target: str, method: str, length: int) -> bytes:
        """Return the request line and headers."""
        lines = (
            f"{method} {target} HTTP/1.1",
            f"Host: {self.host}:{self.port}",
            f"Authorization: Bearer {self.token}",
            f"Content-Length: {length}",
            "Connection: close",
        )
        return "\r\n".join((*lines, "", "")).encode()

    async def ask(self, target: str, method: str = "GET", body: bytes = b"", part: int | None = None) -> int:
        """Return the status of the response, 0 if there is none. Send only `part` bytes of head and body."""
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
    """Current resident memory of a process, in bytes."""
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * 4096


async def watch(client: Client, process: int, attacker: BaseProcess, times: list[float], memory: list[int]) -> None:
    """Request the project repeatedly during an attack, and measure the memory."""
    while attacker.is_alive():
        begun = time.perf_counter()
        assert await client.ask("/api/project") == 200
        times.append(time.perf_counter() - begun)
        memory.append(resident(process))
        await asyncio.sleep(0.02)


def attack(address: str, answers: Any) -> None:
    """Send everything at once and report the statuses. Runs in a separate process to delay no other client."""
    answers.put(asyncio.run(storm(Client(address))))


async def storm(client: Client) -> Counter:
    """Return the statuses of the responses; -1 for none."""
    target, data, large = "/api/uploads?name=x.png", bomb(), bytes(20_000_000)
    attacks = [client.ask(target, "POST", data) for _ in range(N_UPLOADS)]
    attacks += [client.ask(target, "POST", large) for _ in range(N_LARGE)]
    attacks += [client.ask(target, "POST", data, (40, 400)[i % 2]) for i in range(N_HALF)]
    done, left = await asyncio.wait([asyncio.create_task(one) for one in attacks], timeout=SECONDS)
    for one in left:
        one.cancel()
    return Counter([one.result() for one in done] + [-1] * len(left))


def main() -> None:
    """Print memory and response times."""
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
