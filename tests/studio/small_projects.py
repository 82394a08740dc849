"""Projects of small pictures, and what is asked of them in many tests."""

import httpx
import pytest
from contract_checks import check_answer

from liaam.studio.refusal import Refusal

TRIANGLE = {"names": ["a", "b", "c"], "contours": [{"indices": [0, 1, 2], "closed": True}], "mirror": [1, 0, 2]}
POINTS = [[1.0, 2.0], [30.5, 2.25], [15.0, 20.0]]


def browser_of(url: str = "", **options) -> httpx.Client:
    """Give what asks a studio as a browser does.

    It speaks http, which needs none of the certificates that take long to read, and knows no proxies. Answers that do
    not keep the contract fail the test.
    """
    ready = {"base_url": url, "verify": False, "trust_env": False, "timeout": 60}
    return httpx.Client(**{**ready, "event_hooks": {"response": [check_answer]}, **options})


def by_name(project):
    return {picture["name"]: picture for picture in project.overview().pictures}


def states(project):
    return {name: picture["state"] for name, picture in by_name(project).items()}


def refused(call, *arguments):
    with pytest.raises(Refusal) as caught:
        call(*arguments)
    return caught.value


def put(project, name, points, revision=None, invisible=()):
    return project.save_marks(name, {"points": points, "invisible": list(invisible), "revision": revision})


def proposal(uncertainty=0.01, *, points=POINTS, ok=True, found=True, message="The fit converged."):
    return {
        "points": points, "covariances": [[[1, 0], [0, 1]]] * 3, "quality": 0.9, "status": "converged", "ok": ok,
        "message": message, "found": found, "doubtful": not (ok and found), "uncertainty": uncertainty,
    }  # fmt: skip
