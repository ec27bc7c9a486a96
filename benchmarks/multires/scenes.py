"""The subjects: what each scene is, who makes its reference, and how far a camera may travel in it."""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmarks import real
from benchmarks.multires import builders, variants
from benchmarks.sources import Source, file_hash, find, scenes_folder, text_hash

OWN = Path(__file__).resolve().parents[2] / "scenes_blend"
SIZE = (320, 240)


@dataclass(frozen=True)
class Subject:
    """A scene of these benchmarks.

    about: what it tries, in a few words. reach: metres that the camera travels forward in benchmarks.multires.path.
    reference: the method whose converged image is the truth. build: a builder, or None where another driver has it.
    files: what the builder reads, of scenes_blend/ ("own:...") or of POINTMR_SCENES. change: what another driver's
    scene goes without, for all renderers alike.
    """

    about: str
    reach: float
    reference: str = "cycles"
    build: Callable[[], None] | None = None
    files: tuple[str, ...] = ()
    change: Callable[[Source], Source] | None = None


SUBJECTS: dict[str, Subject] = {
    "forest_1e15": Subject("2 x 10^15 triangles of forest; Cycles cannot load it", 20.0, "distributed"),
    "forest_cut": Subject(
        "its trees within 250 m", 20.0, build=builders.forest_cut, files=("own:forest_1e15.blend",)
    ),
    "gn_trees": Subject(
        "45,839 instances by geometry nodes, leaves cut out by alpha; without subsurface scattering",
        4.0,
        change=variants.on_surfaces,
    ),
    "dragon_near": Subject(
        "871,414 triangles, a few a pixel", 0.5, build=builders.dragon_near, files=(builders.DRAGON,)
    ),
    "dragon_far": Subject(
        "400 such dragons, hundreds of triangles a pixel",
        4.0,
        build=builders.dragon_far,
        files=(builders.DRAGON,),
    ),
    "horizon": Subject("fine checks and noise to the horizon", 6.0, build=builders.horizon),
    "fence": Subject("rows of wire mesh, wires far thinner than a pixel", 4.0, build=builders.fence),
    "mirrors": Subject(
        "balls and rings of chrome, glass and satin metal on checks", 1.0, build=builders.mirrors
    ),
    "hair": Subject("200 instances of hair", 0.3),
    "still_life": Subject("area lights, depth of field, glossy and glass", 0.15),
    "bmw27": Subject("cars under emissive meshes, glass, metal, depth of field", 1.0),
}
_DRIVERS = {"gn_trees": "gn_trees", "hair": "armory_hair", "bmw27": "bmw27"}


def subject_of(name: str) -> Subject:
    """The subject of a name, of "fence" as of "fence:coverage"."""
    return SUBJECTS[name.partition(":")[0]]


def source(name: str) -> Source:
    """The scene of a subject, or of a variant of it ("fence:coverage", see variants.ABOUT).

    Raises KeyError for an unknown name, FileNotFoundError for a file that is missing.
    """
    name, _, kind = name.partition(":")
    if kind:
        return variants.variant(source(name), kind)
    if name not in SUBJECTS:
        raise KeyError(f"'{name}' is not one of {', '.join(SUBJECTS)}")
    subject = SUBJECTS[name]
    if name in _DRIVERS:
        found = real.source(_DRIVERS[name])
        found = found if subject.change is None else subject.change(found)
        return Source(name, found.load, found.content, SIZE, found.overrides, "multires")
    if subject.build is None:
        return find(str(OWN / f"{name}.blend"))
    content = text_hash([file_hash(_file(f)) for f in subject.files], builder_text(subject.build))
    return Source(name, subject.build, content, SIZE, {}, "multires")


def _file(name: str) -> Path:
    kind, _, rest = name.rpartition(":")
    folder = OWN if kind else scenes_folder()
    if folder is None or not (folder / rest).is_file():
        raise FileNotFoundError(f"no {rest} in {'scenes_blend' if kind else 'POINTMR_SCENES'}")
    return folder / rest


def builder_text(build: Callable) -> str:
    """The source of a builder and of all in its module that it names, directly or not: a change of one scene leaves
    the references of the others.
    """
    here = vars(builders)
    texts, waiting = {}, [build.__name__]
    while waiting:
        name = waiting.pop()
        if name in texts:
            continue
        thing = here[name]
        if inspect.ismodule(thing):  # which only says where it is installed
            continue
        texts[name] = inspect.getsource(thing) if inspect.isfunction(thing) else repr(thing)
        named = set(re.findall(r"\w+", texts[name])) & here.keys()
        waiting += [
            n for n in named if getattr(here[n], "__module__", builders.__name__) == builders.__name__
        ]
    return json.dumps(texts, sort_keys=True)
