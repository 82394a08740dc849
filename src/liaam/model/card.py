"""What the users of a model should know before they use it. The model's file holds it."""

from dataclasses import asdict, dataclass, fields

from liaam.errors import ModelFileError
from liaam.model.file_format import LONGEST_OF_CARD


@dataclass(frozen=True)
class ModelCard:
    """What a model is for, what it was made from, how accurate it is, and on what terms it may be used.

    Each is a text, or empty if it is not stated. ``liaam show`` prints them, and ``liaam card`` changes them.

    Attributes
    ----------
    purpose : str
        Images that the model is for.
    data : str
        What the training images show, and where they are from.
    accuracy : str
        How accurate fits were measured to be, and on which images. Training states that of fits to left-out images.
    limits : str
        What the model should not be used for.
    licence : str
        Terms of the model, such as ``CC BY 4.0``.
    credit : str
        Whom to credit for the model and its training images.

    Raises
    ------
    ModelFileError
        If an attribute is not a text, or too long.
    """

    purpose: str = ""
    data: str = ""
    accuracy: str = ""
    limits: str = ""
    licence: str = ""
    credit: str = ""

    def __post_init__(self) -> None:
        for name, text in asdict(self).items():
            if not isinstance(text, str):
                raise ModelFileError(f"{name} of a card: give a text, not {type(text).__name__}")
            if len(text) > LONGEST_OF_CARD:
                raise ModelFileError(
                    f"{name} of a card has {len(text)} characters; say it in {LONGEST_OF_CARD}, or give an address"
                )

    @property
    def stated(self) -> dict[str, str]:
        """What is stated, by name."""
        return {name: text for name, text in asdict(self).items() if text}

    @property
    def missing(self) -> list[str]:
        """Names of what is not stated."""
        return [name for name, text in asdict(self).items() if not text]


EMPTY_CARD = ModelCard()
"""The card of a model of which nothing is stated."""

CARD_FIELDS = tuple(field.name for field in fields(ModelCard))
"""Names of the texts of a card."""
