"""What the server and the page say to each other: routes, and the JSON of requests, answers and events.

These types are the only source. ``python -m making.studio_types`` writes them as TypeScript for the page
(``tests/studio/js/contract.d.ts``), and tests compare that file with them. Answers and events are typed dictionaries,
which the server's functions return. Requests are dataclasses: :func:`given` makes them of what a page has sent, whose
values are still to be checked. A field with a default may be left out. :data:`ROUTES` says which route takes and
answers what, and there are no others.
"""

from dataclasses import MISSING, dataclass, fields
from enum import Enum
from typing import Annotated, Any, Literal, NotRequired, TypedDict, TypeVar

Point = Annotated[list[float] | None, "A position in pixels of the picture, [x, y]; null: not placed."]
Progress = Literal["reading", "broken", "new", "unchecked", "proposed", "partial", "done"]
Kind = Literal["landmark", "semilandmark"]
Origin = Literal["placed", "moved", "confirmed", "accepted", "proposed"]
Source = Literal["file", "proposal", "none"]


class Omitted(Enum):
    """Stands for a field that is left out of a request, where null means something else."""

    OMITTED = "omitted"


OMITTED = Omitted.OMITTED


@dataclass(frozen=True, kw_only=True)
class Request:
    """A request with JSON."""

    folder: Annotated[str | Omitted, "Id of the folder that the page shows."] = OMITTED


@dataclass(frozen=True, kw_only=True)
class Query:
    """What an address says after its question mark: text, for which the page may give numbers."""


T = TypeVar("T")


def given(kind: type[T], data: Any) -> T:
    """Return the fields of a request or a query as they were sent: nothing says that they are of their types.

    ``data`` is a mapping; a field that has to be there and is not, is None.
    """
    values = {}
    for field in fields(kind):  # type: ignore[arg-type]
        if field.name in data:
            values[field.name] = data[field.name]
        elif field.default is MISSING:
            values[field.name] = None
    return kind(**values)


class Contour(TypedDict):
    """A curve through points, by index."""

    indices: list[int]
    closed: bool
    name: Annotated[NotRequired[str], "What a person calls it; empty if nothing."]


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
    nothing_found: Annotated[NotRequired[bool], "Whether its proposal is a guess: the model finds no object in it."]
    checked: Annotated[NotRequired[str | None], "Who checked its landmarks."]
    slip: Annotated[NotRequired[str | None], "What looks wrong with its landmarks."]
    slip_points: Annotated[NotRequired[list[int]], "Indices of these points."]
    left_out: Annotated[NotRequired[str | None], "Who left it out of training."]
    absent: Annotated[NotRequired[int], "Number of points that the object lacks."]
    unconfirmed: Annotated[NotRequired[int], "Number of points that no person placed, moved or confirmed one by one."]
    proposed: Annotated[NotRequired[int], "Number of these that no person accepted either, so that it is not done."]
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


@dataclass(frozen=True, kw_only=True)
class SaveTemplate(Request):
    """A request to save the template, and to change all landmark files with it."""

    names: list[str]
    kinds: list[Kind] | None = None
    contours: list[Contour] | None = None
    mirror: list[int] | None = None
    points: Annotated[list[Point] | None, "A typical layout."] = None
    mapping: Annotated[list[int | None] | None, "The old index of each point, null of a new one."] = None
    revision: Annotated[str | Omitted | None, "Of the template that was changed."] = OMITTED


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


class SharedScale(TypedDict):
    """The scale bar of all pictures that have a scale, if these are several and it is one."""

    bar: Bar | None
    of: Annotated[str, "A picture that has it; empty without one."]
    without: Annotated[list[str], "The pictures of its size that have no scale."]


class Pixel(TypedDict):
    """The length of a pixel."""

    length: float
    unit: str


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
    covariances: Annotated[list[list[list[float]]] | None, "Of the points that the model proposes, even beside a file."]
    fitted: Annotated[list[Point] | None, "These points, which the covariances belong to."]
    quality: float | None
    status: str | None
    doubtful: bool
    error: str | None
    width: int
    height: int
    bar: Bar | None
    bar_shared: Annotated[bool, "Whether it was drawn on another picture, so that its place here means nothing."]
    pixel: Annotated[Pixel | None, "By the scale of the landmark file, or that of Measure, where there is no bar."]
    beside: Annotated[str, "Changes with the absent points and the origins, which the file does not hold."]


@dataclass(frozen=True, kw_only=True)
class Base:
    """What a page has changed from, beside the landmark file."""

    absent: list[int] | Omitted = OMITTED
    origins: list[Origin | None] | Omitted = OMITTED


@dataclass(frozen=True, kw_only=True)
class SaveMarks(Request):
    """A request to save the landmarks of a picture."""

    points: list[Point]
    invisible: list[int] | Omitted = OMITTED
    absent: list[int] | Omitted = OMITTED
    origins: list[Origin | None] | None = None
    base: Annotated[Base | None, "With it, what others have changed meanwhile of other points stays."] = None
    bar: Bar | Omitted | None = OMITTED
    revision: str | None
    template: Annotated[str | Omitted | None, "Revision of the template of the points."] = OMITTED
    unchecked: Annotated[bool | Omitted, "Whether a picture without points was left at the mean shape."] = OMITTED
    who: str | None = None


class Saved(TypedDict):
    """The answer to it."""

    revision: str | None
    beside: str
    merged: Annotated[bool, "Whether others had changed absent points or origins, which were kept."]
    picture: Picture


@dataclass(frozen=True, kw_only=True)
class Review(Request):
    """A request to do something to several pictures."""

    pictures: list[str]
    did: str
    who: str | None = None
    bar: Annotated[Bar | None, "For the action scaled."] = None
    of: Annotated[str | None, "The picture on which it was drawn."] = None
    anyway: Annotated[bool, "Whether pictures of another size, or with a scale of their own, get it as well."] = False


class Reviewed(TypedDict):
    """What an action on several pictures has done."""

    changed: list[str]
    refused: Annotated[dict[str, str], "Reasons by name."]


@dataclass(frozen=True, kw_only=True)
class SaveSides(Request):
    """A request to say the sides of the objects in pictures."""

    sides: Annotated[dict[str, str], "left, right, or empty to withdraw what was said, by picture."]


class FoundSide(TypedDict):
    """The side of the object in a picture, and whether all pictures show the same."""

    side: Annotated[str, "left, right, original or mirrored, as stated, by its name or its shape; empty if not known."]
    both: Annotated[bool, "Whether the pictures show two sides, as far as is known."]


class SidesBefore(TypedDict):
    """The answer to a request that says the sides of pictures."""

    before: Annotated[dict[str, str], "What was said of them, by picture; to undo it."]


@dataclass(frozen=True, kw_only=True)
class RemovePictures(Request):
    """A request to remove pictures from the folder."""

    pictures: list[str]


@dataclass(frozen=True, kw_only=True)
class RestorePictures(Request):
    """A request to bring removed pictures back."""

    token: Annotated[str, "As the answer to the removal has it."]


@dataclass(frozen=True, kw_only=True)
class RenamePicture(Request):
    """A request to rename a picture."""

    picture: str
    to: Annotated[str, "As a person has typed it."]


class Removed(TypedDict):
    """Pictures that were removed from the folder, or restored."""

    token: Annotated[str, "Restores them."]
    pictures: list[str]


class Renamed(TypedDict):
    """A picture that was renamed."""

    before: str
    name: str


class Added(TypedDict):
    """A file that was added to the folder."""

    name: Annotated[str, "In the folder."]
    kind: Literal["picture", "landmarks"]
    known: Annotated[bool, "Whether the same file was there before."]


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


@dataclass(frozen=True, kw_only=True)
class StartTraining(Request):
    """A request to train."""

    slips: Annotated[bool, "Whether to train on points that look wrong, too."] = False


@dataclass(frozen=True, kw_only=True)
class StopTraining(Request):
    """A request to stop the training."""


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
    error: Annotated[float, "Median of the fits that have not failed; if all have, of these."]
    held_out: int
    failed: Annotated[list[str], "Held-out pictures whose fits failed, and said so."]
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
    relit_pixels: Annotated[int, "Of flat and relit pictures that are saved; larger ones are reduced to it."]


class Measuring(TypedDict):
    """What is measured of the pictures, as it is kept with the folder."""

    measures: Annotated[list[str], "Such as distance:1-5, with numbers of points."]
    scale: Annotated[str, "Of pictures that have none, such as 0.005 mm, or of all, such as 11-12=5 mm; else empty."]
    by: Annotated[str, "What groups pictures: folder, name or table; empty if nothing."]
    names: Annotated[dict[str, str], "What a person calls measures, by measure."]
    gone: Annotated[list[str], "What a change of the template has removed with its points, in words."]


@dataclass(frozen=True, kw_only=True)
class SaveMeasuring(Request):
    """A request to change what is measured."""

    add: Annotated[list[str] | Omitted, "Measures, with numbers or names of points."] = OMITTED
    remove: Annotated[list[str] | Omitted, "Measures as they are kept."] = OMITTED
    names: Annotated[dict[str, str] | Omitted, "New names of measures; an empty one takes the name away."] = OMITTED
    scale: str | Omitted = OMITTED
    by: str | Omitted = OMITTED
    seen: Annotated[bool, "Whether what is gone was seen, and need not be said again."] = False


@dataclass(frozen=True, kw_only=True)
class UseModel(Request):
    """A request to use the face model instead of the folder's own, or that one again."""

    source: Literal["face", "studio"]


@dataclass(frozen=True, kw_only=True)
class SaveWho(Request):
    """A request to keep the name of the person who works in the page."""

    who: str


class Who(TypedDict):
    """The name of the person who works in the page."""

    who: str


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
    looking: Annotated[bool, "Whether faces are being looked for: then the face model offers its points."]
    model: Model | None
    face_again: Annotated[bool, "Whether the face model can be used instead of the folder's own."]
    set_aside: Annotated[bool, "Whether a person went back to the face model: none is trained by itself."]
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
    measuring: Measuring
    who: Annotated[str, "The name that a person last gave in this set of landmarks; empty if none did."]


class Unchanged(TypedDict):
    """The answer if nothing has changed since a stamp."""

    unchanged: Literal[True]
    stamp: str


class Column(TypedDict):
    """A measure of all pictures with landmarks."""

    measure: Annotated[str | None, "Such as distance:1-5; null: the centroid size."]
    called: Annotated[str, "What a person calls it; empty if nothing."]
    name: str
    unit: Annotated[str, "px, °, or a unit of length or area."]
    values: Annotated[list[float | None], "null: a landmark is missing, or the picture has no scale."]
    p: Annotated[float | None, "That the means of the groups differ so by chance; null without two groups."]


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


@dataclass(frozen=True, kw_only=True)
class SaveGroups(Request):
    """A request to keep a table of groups."""

    text: Annotated[str, "Of a .csv file."]
    name: Annotated[str, "Of that file."]


class Grouped(TypedDict):
    """A table of groups that was kept."""

    specimens: Annotated[int, "Number of those in the table."]


class Shapes(TypedDict):
    """Measures of all pictures with landmarks, and the space of their shapes."""

    pictures: list[str]
    groups: Annotated[list[str], "Group of each; empty if it has none."]
    estimated: Annotated[list[int], "Number of points of each that were estimated."]
    unscaled: Annotated[list[int], "Indices of pictures without a scale, where others have one."]
    columns: list[Column]
    space: Space | None
    why_not: Annotated[str, "Why there is no space."]
    sides: Annotated[str, "What was done about left and right; empty if nothing."]
    tests: list[GroupTest]
    has_table: Annotated[bool, "Whether a table of groups was given."]


@dataclass(frozen=True, kw_only=True)
class MakeSet(Request):
    """A request to make a further set of landmarks."""

    name: str
    same: Annotated[bool, "Whether it has the points of the set that the page shows."] = False


class MadeSet(TypedDict):
    """A set of landmarks that was made."""

    name: str


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
    pixel: Annotated[Pixel | None, "Of all these pictures; null if some have no scale, or another one."]
    sd: float
    percent: float
    repeatability: float | None
    points: Annotated[list[tuple[str, float, float]], "Name, deviation in pixels, and in percent of the size."]
    pictures: Annotated[list[tuple[str, float]], "Name and deviation."]
    unconfirmed: Annotated[list[str], "Pictures that do not count, since points were accepted as they were proposed."]
    alone: Annotated[dict[str, str], "The only observer who has placed all points of a picture, by other pictures."]
    file: str
    table: str
    shapes: Annotated[list[ShapeAgreement], "Of each other observer and the set that is shown, from 5 pictures on."]


@dataclass(frozen=True, kw_only=True)
class Start:
    """Where a fit starts: a box, or a shape."""

    box: Annotated[list[float] | None, "Left, top, right and bottom."] = None
    shape: list[Point] | None = None


@dataclass(frozen=True, kw_only=True)
class FitAll(Request):
    """A request to fit all specimens of a picture, either of the folder or dropped."""

    picture: Annotated[str | None, "Name of a picture of the folder."] = None
    upload: Annotated[str | None, "Id of a dropped one."] = None
    method: str | Omitted = OMITTED
    side: Annotated[str | Omitted, "Of the object: auto, or one of the model's."] = OMITTED


@dataclass(frozen=True, kw_only=True)
class FitOne(FitAll):
    """A request to fit the object in a picture."""

    start: Annotated[Start | None, "null: the object is searched for."] = None


class Seconds(TypedDict):
    """How long the parts of a fit took."""

    search: float
    fit: float


class Found(TypedDict):
    """How an object was found."""

    score: float
    doubtful: bool


class Iteration(TypedDict):
    """An iteration of a fit."""

    shape: list[list[float | None]]
    level: int
    cost: float | None
    theta_deg: float | None


class FitError(TypedDict):
    """The mean distance of a fit from the landmarks of the picture."""

    pixels: float
    percent: Annotated[float, "Of the diagonal of the landmarks."]


class Specimen(TypedDict):
    """Which of several specimens a fit is of."""

    number: Annotated[int, "From 1, in reading order."]
    name: str
    fault: Annotated[str, "What is not clear about it; empty if nothing."]


class Fit(TypedDict):
    """A fit to a picture, in its pixels. Numbers that are not finite are null."""

    id: str
    method: str
    status: str
    ok: Annotated[bool, "Whether its landmarks may be used."]
    message: str
    quality: float | None
    side: str | None
    theta_deg: float | None
    cost: float | None
    n_found: Annotated[int | None, "Number of objects that the search has found in the picture; null: it had a start."]
    seconds: Seconds
    shape: list[list[float | None]]
    absent: Annotated[list[int], "Landmarks that the object lacks."]
    covariances: list[list[list[float | None]]]
    deviations: Annotated[list[float | None], "Standard deviations of the landmarks."]
    found: Annotated[Found | None, "null: the fit had a start."]
    nothing_found: Annotated[bool, "Whether neither the search nor the fit has found an object: the fit is a guess."]
    objects: Annotated[list[list[float]], "Boxes of several objects, the one that was fitted first."]
    iterations: list[Iteration]
    trained_on: Annotated[bool, "Whether the model was trained on this picture."]
    error: FitError | None
    triangles: list[list[int]]
    contours: list[Contour]
    width: int
    height: int
    layers: Annotated[list[str], "Those that can be drawn."]
    no_flat: Annotated[str | None, "Why its shading cannot be computed."]
    specimen: Annotated[Specimen | None, "null: it was fitted alone."]
    picture: Annotated[NotRequired[str], "Name of the picture, or"]
    upload: Annotated[NotRequired[str], "id of the dropped one."]


class Fits(TypedDict):
    """Fits of all specimens of a picture, in reading order."""

    fits: list[Fit]
    faults: Annotated[list[str], "What is not clear about the picture."]


class Upload(TypedDict):
    """A dropped picture, which is kept for a while."""

    id: str
    name: str
    width: int
    height: int
    fit: Annotated[Fit | None, "null: none was asked for, or it failed."]


class ColourScale(TypedDict):
    """The colours of a layer, sent beside it."""

    limit: Annotated[float, "The value of the last colour; that of the first is its negative."]
    what: str
    even: Annotated[NotRequired[bool], "Of the shading: as LayerChange has it."]


class LayerChange(TypedDict):
    """What the flat picture, or that of corrected colour, changes, sent beside it."""

    even: Annotated[bool, "Whether the light is so much as in training that nothing that can be seen is taken off."]
    colour: Annotated[str, "Name of the colour of the light, such as orange; empty: as in training."]


class LayerPlace(TypedDict):
    """The part of the picture that a layer covers, sent beside it."""

    box: Annotated[list[float], "Left, top, width and height, as fractions of the picture's sides."]


@dataclass(frozen=True, kw_only=True)
class SentLamp:
    """A distant lamp of a light that is sent."""

    direction: Annotated[list[float], "x to the right, y down, z to the viewer."]
    colour: Annotated[list[float] | Omitted, "Red, green and blue as on the screen (sRGB), 0 to 1."] = OMITTED
    strength: float = 1.0
    softness: float = 0.0


@dataclass(frozen=True, kw_only=True)
class SentLight:
    """The light of a relit picture, which an address holds as JSON."""

    lamps: list[SentLamp]
    ambient: Annotated[float | Omitted, "Fraction of white ambient light."] = OMITTED


class LiveVideo(TypedDict):
    """A video that is tracked while it plays."""

    id: str
    header: Annotated[str, "First line of the table that the rows of its frames make."]


class LandmarksChanged(TypedDict):
    """The landmarks of a picture were saved, by any page."""

    name: str
    revision: Annotated[str | None, "null or empty: there is no file any more."]
    beside: Annotated[NotRequired[str], "Changes with what is kept beside the file."]


class FolderChanged(TypedDict):
    """Something in the folder, or of its models, has changed: the page asks for the project again."""


class Details(TypedDict):
    """What a refusal may say beside the error."""

    folder: Annotated[NotRequired[str], "The page shows another folder than this one, by its id."]
    current: Annotated[NotRequired[Marks], "The landmarks, which were changed since the page read them."]
    template: Annotated[NotRequired[Template | None], "The template, which was changed since the page read it."]
    training: Annotated[NotRequired[Training], "The training that is running already."]
    proposed: Annotated[NotRequired[int], "Pictures whose points are only proposed, where accepted ones are needed."]


class Fault(Details):
    """The answer to a request that is refused or has failed."""

    error: Annotated[str, "What is wrong, and what to do, in a sentence for the person."]


EVENTS: dict[str, Any] = {
    "project": FolderChanged,
    "training": Training,
    "fitting": Counted | None,
    "landmarks": LandmarksChanged | list[LandmarksChanged],
}
"""Data of the events that the server sends, by kind."""


@dataclass(frozen=True, kw_only=True)
class ProjectQuery(Query):
    """Asks for the project, unless nothing has changed."""

    stamp: Annotated[str | None, "Of the project that the page has."] = None


@dataclass(frozen=True, kw_only=True)
class ImageQuery(Query):
    """Asks for a picture or a layer in a size."""

    size: Annotated[str | None, "Longest side in pixels."] = None
    tag: Annotated[str | None, "Of the file; with it, the browser keeps the answer."] = None


@dataclass(frozen=True, kw_only=True)
class TileQuery(Query):
    """Asks for a tile of a picture."""

    tag: Annotated[str | None, "Of the file; with it, the browser keeps the answer."] = None


@dataclass(frozen=True, kw_only=True)
class ScaleQuery(Query):
    """Asks for the scale of a picture, by what is in it."""

    kind: Annotated[str | None, "ruler or bar."] = None
    length: Annotated[str | None, "From one smallest tick to the next, or of the bar."] = None
    unit: str | None = None


@dataclass(frozen=True, kw_only=True)
class ShapesQuery(Query):
    """Says what is measured of the pictures, and how."""

    measures: Annotated[str, "Such as distance:1-5, with spaces between them."] = ""
    scale: str | None = None
    by: Annotated[str, "Groups: folder, name or table."] = ""
    estimate: Annotated[str | None, "Whether missing points are estimated."] = None
    only: Annotated[str | None, "Whether a table has the measures only, without coordinates, scores and errors."] = None


@dataclass(frozen=True, kw_only=True)
class FileQuery(Query):
    """Says the name of the file that is sent."""

    name: str = ""


@dataclass(frozen=True, kw_only=True)
class UploadQuery(FileQuery):
    """Says the name of the picture that is sent, and how to fit it."""

    method: Annotated[str | None, "null: it is not fitted."] = None


@dataclass(frozen=True, kw_only=True)
class LayerQuery(Query):
    """Asks for a layer of a fit in a size."""

    size: Annotated[str | None, "Longest side in pixels."] = None
    balance: Annotated[str, "0: the flat picture keeps the colour of its light."] = ""


@dataclass(frozen=True, kw_only=True)
class LightQuery(Query):
    """Asks for the object of a fit under another light."""

    light: Annotated[str | None, "A SentLight as JSON; null: one lamp beside the camera."] = None
    size: str | None = None
    balance: Annotated[str, "0: the picture keeps the colour of its own light."] = ""


@dataclass(frozen=True, kw_only=True)
class FitFileQuery(Query):
    """Asks for a file of a fit."""

    what: str = ""
    light: Annotated[str | None, "A SentLight as JSON, for a relit picture."] = None
    opacity: Annotated[str | None, "Of the changed picture over the picture, 0 to 1; null: 1."] = None
    balance: Annotated[str, "0: a flat or relit picture keeps the colour of its own light."] = ""


@dataclass(frozen=True, kw_only=True)
class FitsQuery(Query):
    """Says which fits are in a table."""

    fits: Annotated[str, "Their ids, with commas between them."] = ""


@dataclass(frozen=True, kw_only=True)
class FrameQuery(Query):
    """Says what the frame of a video is that is sent."""

    width: str
    height: str
    of_width: Annotated[str, "Width of the video, of which the frame may be a reduced copy."]
    of_height: str
    number: str
    time: Annotated[str, "In seconds."]
    fresh: Annotated[str, "1: it does not follow the frame before."] = ""
    flat: Annotated[str, "1: its picture without shading is sent back."] = ""


@dataclass(frozen=True)
class Endpoint:
    """What a request takes and is answered with: a type of JSON; bytes, those of a file; or None, nothing."""

    answer: Any = None
    query: type[Query] | None = None
    body: Any = None


ROUTES = {
    "GET project": Endpoint(Project | Unchanged, ProjectQuery),
    "GET events": Endpoint(bytes),
    "GET pictures/{name}/image": Endpoint(bytes, ImageQuery),
    "GET pictures/{name}/chroma": Endpoint(bytes, ImageQuery),
    "GET pictures/{name}/tiles/{level}/{column}/{row}": Endpoint(bytes, TileQuery),
    "GET pictures/{name}/landmarks": Endpoint(Marks),
    "PUT pictures/{name}/landmarks": Endpoint(Saved, body=SaveMarks),
    "GET pictures/{name}/history": Endpoint(list[HistoryEntry]),
    "GET pictures/{name}/side": Endpoint(FoundSide),
    "GET pictures/{name}/scale": Endpoint(FoundScale, ScaleQuery),
    "GET pictures/{name}/others": Endpoint(dict[str, list[Point]]),
    "GET scale": Endpoint(SharedScale),
    "POST review": Endpoint(Reviewed, body=Review),
    "PUT sides": Endpoint(SidesBefore, body=SaveSides),
    "POST files": Endpoint(Added, FileQuery, bytes),
    "POST removed": Endpoint(Removed, body=RemovePictures),
    "POST restored": Endpoint(Removed, body=RestorePictures),
    "POST renamed": Endpoint(Renamed, body=RenamePicture),
    "PUT template": Endpoint(Template | None, body=SaveTemplate),
    "POST template/file": Endpoint(Template, FileQuery, bytes),
    "POST sets": Endpoint(MadeSet, body=MakeSet),
    "GET agreement": Endpoint(Agreement),
    "GET agreement/model": Endpoint(ShapeAgreement),
    # The header x-both-sides is there if specimens of two sides are in the file, as they lie in the pictures.
    "GET export/{kind}": Endpoint(bytes),
    "GET measurements": Endpoint(bytes, ShapesQuery),
    "GET shapes": Endpoint(Shapes, ShapesQuery),
    "PUT groups": Endpoint(Grouped, body=SaveGroups),
    "PUT measuring": Endpoint(Measuring, body=SaveMeasuring),
    "PUT who": Endpoint(Who, body=SaveWho),
    "POST training": Endpoint(Training, body=StartTraining),
    "DELETE training": Endpoint(Training, body=StopTraining),
    "GET model/file": Endpoint(bytes),
    "DELETE model/face": Endpoint(),
    "PUT model": Endpoint(body=UseModel),
    "POST model/guest": Endpoint(None, FileQuery, bytes),
    "DELETE model/guest": Endpoint(),
    "POST uploads": Endpoint(Upload, UploadQuery, bytes),
    "GET uploads/{id}/image": Endpoint(bytes, ImageQuery),
    "GET uploads/{id}/chroma": Endpoint(bytes, ImageQuery),
    "GET uploads/{id}/tiles/{level}/{column}/{row}": Endpoint(bytes, TileQuery),
    "POST fits": Endpoint(Fit, body=FitOne),
    "POST fits/all": Endpoint(Fits, body=FitAll),
    "GET fits/table": Endpoint(bytes, FitsQuery),
    # The header x-scale has a ColourScale, a LayerChange or a LayerPlace.
    "GET fits/{id}/layers/{layer}": Endpoint(bytes, LayerQuery),
    "GET fits/{id}/relit": Endpoint(bytes, LightQuery),
    "GET fits/{id}/export": Endpoint(bytes, FitFileQuery),
    "POST recordings": Endpoint(bytes, body=bytes),
    "POST live": Endpoint(LiveVideo),
    "POST live/{id}/frames": Endpoint(bytes, FrameQuery, bytes),
    "DELETE live/{id}": Endpoint(),
}
"""All routes, by method and address below ``/api/``."""
