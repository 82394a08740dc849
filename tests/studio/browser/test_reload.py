"""What a reload fetches: a few answers, and none of the files of the page again."""

import pytest
from people import NAMES, opened, wait_for

pytestmark = pytest.mark.slow

MOST_REQUESTS, MOST_BYTES = 12, 50_000


def fetched(page, act) -> dict[str, int]:
    """Bytes that come over the network during an action, by address."""
    session = page.context.new_cdp_session(page)
    session.send("Network.enable")
    addresses, kept, sizes = {}, set(), {}
    session.on(
        "Network.requestWillBeSent", lambda event: addresses.update({event["requestId"]: event["request"]["url"]})
    )
    session.on("Network.requestServedFromCache", lambda event: kept.add(event["requestId"]))
    session.on("Network.loadingFinished", lambda event: sizes.update({event["requestId"]: event["encodedDataLength"]}))
    act()
    page.wait_for_timeout(1500)  # thumbnails follow the page
    session.detach()
    sent = {key: url for key, url in addresses.items() if key not in kept and sizes.get(key, 1) > 0}
    return {f"{url} {key}": sizes.get(key, 0) for key, url in sent.items() if url.startswith("http")}


def test_a_reload_is_small(serve, page, marked):
    page.goto(serve(marked).address)
    opened(page, NAMES[0])
    page.wait_for_timeout(1500)

    def reload():
        page.reload()
        opened(page, NAMES[0])
        wait_for(page, "() => document.querySelectorAll('[role=tab]').length === 5")

    found = fetched(page, reload)
    assert len(found) <= MOST_REQUESTS, sorted(found)
    assert sum(found.values()) <= MOST_BYTES, found
    assert not [address for address in found if "/kept/" in address]
