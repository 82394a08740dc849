"""Random expressions of scanned heads, by ARKit's names."""

import numpy as np


def random_expression(rng: np.random.Generator) -> dict[str, float]:
    """Draw the strengths of an expression: a mouth that speaks, smiles or grimaces, brows and lids that move."""
    kind = rng.choice(["speaking", "smile", "laugh", "grimace"])
    strengths = {"speaking": _speaking, "smile": _smile, "laugh": _laugh, "grimace": _grimace}[kind](rng)
    if rng.random() < 0.4:
        strengths |= _brows(rng)
    if rng.random() < 0.35:
        strengths |= _both("eyeBlink", rng.uniform(0.3, 1.0))
    return strengths


def _speaking(rng: np.random.Generator) -> dict[str, float]:
    """Return a mouth that is open by any degree, with round or wide lips."""
    lips = (
        {"mouthFunnel": rng.uniform(0.0, 0.7)} if rng.random() < 0.4 else _both("mouthStretch", rng.uniform(0.0, 0.8))
    )
    return {"jawOpen": rng.uniform(0.1, 1.0), **lips, **_both("mouthUpperUp", rng.uniform(0.0, 0.5))}


def _smile(rng: np.random.Generator) -> dict[str, float]:
    """Return a smile with closed lips, or with teeth."""
    teeth = rng.uniform(0.0, 0.6) if rng.random() < 0.6 else 0.0
    return {
        **_both("mouthSmile", rng.uniform(0.3, 1.0), rng.normal(0.0, 0.1)),
        **_both("mouthUpperUp", teeth),
        **_both("mouthLowerDown", 0.7 * teeth),
        **_both("cheekSquint", rng.uniform(0.0, 0.8)),
        **_both("eyeSquint", rng.uniform(0.0, 0.6)),
    }


def _laugh(rng: np.random.Generator) -> dict[str, float]:
    """Return a smile with an open mouth."""
    return {
        **_smile(rng),
        **_both("mouthUpperUp", rng.uniform(0.2, 0.8)),
        **_both("mouthLowerDown", rng.uniform(0.0, 0.5)),
        "jawOpen": rng.uniform(0.1, 0.7),
    }


def _grimace(rng: np.random.Generator) -> dict[str, float]:
    """Return a mouth that is pressed, pursed, drawn to a side or down, or bared teeth."""
    side = rng.choice(["mouthLeft", "mouthRight", "jawLeft", "jawRight"])
    choices = [
        _both("mouthFrown", rng.uniform(0.3, 1.0)),
        {"mouthPucker": rng.uniform(0.3, 1.0)},
        {**_both("mouthPress", rng.uniform(0.2, 0.8)), "mouthRollLower": rng.uniform(0.0, 0.6)},
        {side: rng.uniform(0.2, 0.7)},
        {**_both("mouthStretch", rng.uniform(0.3, 1.0)), **_both("noseSneer", rng.uniform(0.2, 0.9))},
    ]
    chosen = choices[rng.integers(len(choices))]
    return {**chosen, "jawOpen": rng.uniform(0.0, 0.3) * (rng.random() < 0.4)}


def _brows(rng: np.random.Generator) -> dict[str, float]:
    """Return brows that are raised or lowered."""
    if rng.random() < 0.5:
        return _both("browDown", rng.uniform(0.3, 1.0))
    strength = rng.uniform(0.3, 1.0)
    return {**_both("browInnerUp", strength), **_both("browOuterUp", strength * rng.uniform(0.3, 1.0))}


def _both(name: str, strength: float, apart: float = 0.0) -> dict[str, float]:
    """Return an expression of both sides of the face, stronger on the left by some."""
    return {f"{name}_L": strength + apart, f"{name}_R": strength - apart}
