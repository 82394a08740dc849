"""What the server and the page say to each other: the JSON of requests, answers and events.

These types are the only source. The server's functions return them, and ``python -m making.studio_types`` writes them
as TypeScript for the page (``tests/studio/js/contract.d.ts``). Tests compare that file, and real answers, with them.
"""

from typing import Annotated, Any, Literal, NotRequired, TypedDict

from liaam.studio.origins import Origin

Point = Annotated[list[float] | None, "A position in pixels of the picture, [x, y]; null: not placed."]
Progress = Literal["reading", "broken", "new", "unchecked", "proposed", "partial", "done"]
Kind = Literal["landmark", "semilandmark"]
Source = Literal["file", "proposal", "none"]


class Contour(TypedDict):
    """A curve through points, by index."""

    indices: list[int]
    closed: bool


class Picture(TypedDict):
    """A picture of the folder, as the list shows it."""

    name: str
    tag: Annotated[str, "Changes with the file."]
    state: Progress
    placed: Annotated[int, "Number of its points that have a position."]
    doubtful: bool
    error: Annotated[NotRequired[str | None], "Why it cannot be used; this and the following lack while it is read."]
    width: NotRequired[int | None]
    height: NotRequired[int | None]
    uncertainty: Annotated[NotRequired[float | None], "Of its proposal, as the next one."]
    quality: NotRequired[float | None]
    rank: Annotated[NotRequired[int | None], "1 is the most useful to annotate."]
    checked: Annotated[NotRequired[str | None], "Who checked its landmarks."]
    slip: Annotated[NotRequired[str | None], "What looks wrong with its landmarks."]
    slip_points: Annotated[NotRequired[list[int]], "Indices of these points."]
    left_out: Annotated[NotRequired[str | None], "Who left it out of training."]
    absent: Annotated[NotRequired[int], "Number of points that the object lacks."]
    unconfirmed: Annotated[NotRequired[int], "Number of points that no person placed, moved or confirmed one by one."]
    revision: Annotated[NotRequired[str | None], "Of the landmark file; null if there is none."]
    side: Annotated[NotRequired[str], "left or right, as a person or the landmark file says; empty if none does."]


class Template(TypedDict):
    """The points that are placed on every picture."""

    names: list[str]
    kinds: list[Kind]
    contours: list[Contour]
    mirror: Annotated[list[int] | None, "Index of each point's twin, its own on the axis."]
    points: list[Point] | None
    revision: NotRequired[str | None]


class Bar(TypedDict):
    """A length in a picture that is known."""

    ends: list[list[float]]
    length: float
    unit: str


class FoundScale(TypedDict):
    """A ruler or a scale bar that is found in a picture."""

    bar: Annotated[Bar, "From the first tick to the last, or from end to end."]
    pixel: Annotated[float, "Length of a pixel, in the unit of the bar."]
    error: Annotated[float, "Its standard error, as a share of it."]
    ticks: Annotated[int | None, "Number of ticks; null of a scale bar."]


class Marks(TypedDict):
    """The landmarks of a picture."""

    points: list[Point]
    invisible: list[int]
    absent: Annotated[list[int], "Points that the object lacks."]
    origins: Annotated[list[Origin | None] | None, "Where the points of a file come from."]
    source: Source
    revision: str | None
    tag: str
    file: str | None
    covariances: list[list[list[float]]] | None
    quality: float | None
    status: str | None
    doubtful: bool
    error: str | None
    width: int
    height: int
    bar: Bar | None
    beside: Annotated[str, "Changes with the absent points and the origins, which the file does not hold."]


class Base(TypedDict):
    """What a page has changed from, beside the landmark file."""

    absent: NotRequired[list[int]]
    origins: NotRequired[list[Origin | None]]


class SaveMarks(TypedDict):
    """A request to save the landmarks of a picture."""

    points: list[Point]
    invisible: NotRequired[list[int]]
    absent: NotRequired[list[int]]
    origins: NotRequired[list[Origin | None]]
    base: Annotated[NotRequired[Base], "With it, what others have changed meanwhile of other points stays."]
    bar: NotRequired[Bar | None]
    revision: str | None
    template: Annotated[NotRequired[str | None], "Revision of the template of the points."]
    unchecked: NotRequired[bool]
    who: NotRequired[str]
    folder: NotRequired[str]


class Saved(TypedDict):
    """The answer to it."""

    revision: str | None
    beside: str
    merged: Annotated[bool, "Whether others had changed absent points or origins, which were kept."]
    picture: Picture


class Reviewed(TypedDict):
    """What an action on several pictures has done."""

    changed: list[str]
    refused: Annotated[dict[str, str], "Reasons by name."]


class SidesBefore(TypedDict):
    """The answer to a request that says the sides of pictures."""

    before: Annotated[dict[str, str], "What was said of them, by picture; to undo it."]


class Removed(TypedDict):
    """Pictures that were removed from the folder, or restored."""

    token: Annotated[str, "Restores them."]
    pictures: list[str]


class Renamed(TypedDict):
    """A picture that was renamed."""

    before: str
    name: str


class HistoryEntry(TypedDict):
    """An entry in the log of a picture."""

    time: str
    who: str
    did: str
    picture: str
    revision: str | None


class Sides(TypedDict):
    """The sides of the training pictures of a model, such as left and right wings."""

    own: Annotated[str, "left, right, or original where it was not stated: the side that the others were reflected to."]
    other: str
    n_own: int
    n_other: int


class Model(TypedDict):
    """The model in use."""

    number: Annotated[int, "Another one for each model that the server uses."]
    name: str
    n_images: int
    n_points: int
    names: Annotated[list[str], "Of its points; none if its training pictures had none."]
    trained: str | None
    stale: Annotated[int, "Number of pictures that were completed or changed since."]
    colour: bool
    methods: Annotated[list[str], "Methods that it can fit with."]
    triangles: list[list[int]]
    theta_deg: float
    contours: list[Contour]
    source: Literal["file", "studio", "guest", "face"]
    left_out: Annotated[dict[str, str], "Why its training left out pictures that have not changed since, by name."]
    mean: list[list[float]]
    sides: Annotated[Sides | None, "null: there is one side only, as far as is known."]
    sides_changed: Annotated[bool, "Whether the side of a training picture was stated or withdrawn since."]


class Training(TypedDict):
    """The state of the training."""

    state: Literal["idle", "running", "done", "failed"]
    done: int
    total: int
    what: str
    error: str | None


class Method(TypedDict):
    """A method that can be fitted with."""

    name: str
    summary: str
    needs_colour: bool


class Version(TypedDict):
    """A trained model, and its error on pictures that were held out."""

    time: str | None
    pictures: int
    error: float
    held_out: int
    same: Annotated[bool, "Whether it was measured on the pictures of the newest."]


class Counted(TypedDict):
    """How much of some work is done."""

    done: int
    total: int


class Formats(TypedDict):
    """Suffixes of the files that can be added."""

    pictures: list[str]
    landmarks: list[str]
    videos: list[str]


class Limits(TypedDict):
    """The largest files and pictures that can be added."""

    upload_bytes: int
    pixels: int


class Project(TypedDict):
    """The folder, as the page shows it."""

    id: str
    stamp: str
    folder: str
    read_only: Annotated[bool, "Whether nothing can be written, so that pictures are only shown, fitted and relit."]
    set: Annotated[str, "The set of landmarks that the page shows."]
    sets: Annotated[list[str], "All sets of the folder; '' is the first one."]
    observers: Annotated[list[str], "The sets of the same points, if there are several."]
    version: str
    pictures: list[Picture]
    template: Template | None
    offered: Annotated[bool, "Whether a model offers the template, and it was not accepted yet."]
    model: Model | None
    checked: Annotated[bool, "Whether slips were looked for in the landmarks as they are."]
    training: Training
    versions: Annotated[list[Version], "Oldest first."]
    methods: list[Method]
    default_method: str
    default_ambient: float
    fitting: Annotated[Counted | None, "Pictures that are being fitted as they arrive."]
    formats: Formats
    limits: Limits
    problems: list[str]


class Unchanged(TypedDict):
    """The answer if nothing has changed since a stamp."""

    unchanged: Literal[True]
    stamp: str


class Column(TypedDict):
    """A measure of all pictures with landmarks."""

    measure: Annotated[str | None, "Such as distance:1-5; null: the centroid size."]
    name: str
    unit: Annotated[str, "px, °, or a unit of length or area."]
    values: Annotated[list[float | None], "null: a landmark is missing, or the picture has no scale."]


class Grid(TypedDict):
    """A grid over the mean shape, and how its points move with each principal component."""

    rows: int
    columns: int
    points: list[list[float]]
    bends: Annotated[list[list[list[float]]], "For a score of 1, by component."]


class Space(TypedDict):
    """The space of shapes, of centroid size 1, y downwards as in pictures."""

    landmarks: Annotated[list[int], "Indices of the points that make the shape."]
    of: Annotated[list[int], "Indices of the pictures that have a shape."]
    mean: list[list[float]]
    shapes: Annotated[list[list[list[float]]], "Those of the first of them, to be drawn over each other."]
    scores: Annotated[list[list[float]], "By picture, of each principal component."]
    axes: Annotated[list[list[list[float]]], "By component: the mean plus scores times axes is a shape."]
    shares: list[float]
    distances: Annotated[list[float], "From the mean shape, in centroid sizes."]
    limit: Annotated[float, "Distance beyond which a shape is unusual."]
    grid: Annotated[Grid | None, "null: the landmarks lie on one line."]


class GroupTest(TypedDict):
    """A permutation test of the difference in shape between groups."""

    groups: str
    specimens: int
    distance: Annotated[float | None, "Between the mean shapes of two groups, in centroid sizes."]
    share: Annotated[float, "Of the groups in the variance of shape."]
    p: float


class Shapes(TypedDict):
    """Measures of all pictures with landmarks, and the space of their shapes."""

    pictures: list[str]
    groups: Annotated[list[str], "Group of each; empty if it has none."]
    estimated: Annotated[list[int], "Number of points of each that were estimated."]
    columns: list[Column]
    space: Space | None
    why_not: Annotated[str, "Why there is no space."]
    sides: Annotated[str, "What was done about left and right; empty if nothing."]
    tests: list[GroupTest]
    has_table: Annotated[bool, "Whether a table of groups was given."]


class ShapeAgreement(TypedDict):
    """How shapes agree with labels, for statistics of shape."""

    names: Annotated[list[str], "Of the two: shapes and labels."]
    pictures: int
    slope: Annotated[float, "Of the shapes on the labels."]
    slope_interval: list[float]
    attenuation: Annotated[float | None, "What a difference between groups is multiplied by; null without groups."]
    attenuation_interval: list[float | None]
    variance_ratio: float
    reliability: float
    repeatability: Annotated[float, "Intraclass correlation."]
    mean_distance: Annotated[float, "Of the mean shapes, in standard errors."]
    p: Annotated[float, "That the mean shapes are as far apart by chance."]
    size_correlation: float
    methods: Annotated[str, "Sentences for the section Methods of a paper."]


class Agreement(TypedDict):
    """How far observers are apart."""

    observers: list[str]
    sd: float
    percent: float
    repeatability: float | None
    points: Annotated[list[tuple[str, float, float]], "Name, deviation in pixels, and in percent of the size."]
    pictures: Annotated[list[tuple[str, float]], "Name and deviation."]
    unconfirmed: Annotated[list[str], "Pictures that do not count, since points were accepted as they were proposed."]
    file: str
    table: str
    shapes: Annotated[list[ShapeAgreement], "Of each other observer and the set that is shown, from 5 pictures on."]


class LandmarksChanged(TypedDict):
    """The landmarks of a picture were saved, by any page."""

    name: str
    revision: Annotated[str | None, "null or empty: there is no file any more."]
    beside: Annotated[NotRequired[str], "Changes with what is kept beside the file."]


class Fault(TypedDict):
    """The answer to a request that is refused or has failed."""

    error: Annotated[str, "What is wrong, and what to do, in a sentence for the person."]
    folder: Annotated[NotRequired[str], "The page shows another folder than this one, by its id."]
    current: Annotated[NotRequired[Marks], "The landmarks, which were changed since the page read them."]
    template: Annotated[NotRequired[Template | None], "The template, which was changed since the page read it."]


EVENTS: dict[str, Any] = {
    "project": dict[str, Any],
    "training": Training,
    "fitting": Counted | None,
    "landmarks": LandmarksChanged | list[LandmarksChanged],
}
"""Data of the events that the server sends, by kind."""

TYPES = (
    Contour, Picture, Template, Bar, FoundScale, Marks, Base, SaveMarks, Saved, Reviewed, SidesBefore, Removed, Renamed,
    HistoryEntry, Sides, Model, Training, Method, Version,
    Counted, Formats, Limits, Project, Unchanged, Column, Grid, Space, GroupTest, Shapes,
    ShapeAgreement, Agreement, LandmarksChanged, Fault,
)  # fmt: skip
"""All types, in the order in which they are written for the page."""
