"""Sample sets on disk: found again by content, and by nothing else; damaged files are as good as none."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pointmr_engine import Group, RenderSettings, Scene, principled, render
from pointmr_engine.hierarchy import set_files
from pointmr_engine.hierarchy.geometry import compile_geometry
from pointmr_engine.hierarchy.sample_sets import NEVER, SampleSets
from pointmr_engine.hierarchy.set_files import SetFiles
from pointmr_engine.scene.graph import Graph, Link, Node
from pointmr_engine.scene.group import SHADOW, VISIBLE, Instances, instance
from pointmr_engine.scene.material import Material
from pointmr_engine.scene.settings import ForwardSettings
from pointmr_engine.scene.texture import Image
from tests.engine.instanced import random_transforms
from tests.engine.small_scenes import lit_floor
from tests.engine.test_sample_sets import bumpy, everything, index_of, nested, sets_of


def same(a: SampleSets, b: SampleSets) -> None:
    np.testing.assert_array_equal(a.sets, b.sets)
    for name in ("row", "source", "place"):
        np.testing.assert_array_equal(getattr(a.surfels, name)[: a.used], getattr(b.surfels, name)[: b.used])
    lengths = len(a.surfels.emission) == 1, len(b.surfels.emission) == 1
    assert lengths[0] == lengths[1]
    np.testing.assert_array_equal(a.surfels.emission[: a.used], b.surfels.emission[: b.used])


def filled(root: Group, folder, **options) -> SampleSets:
    sets = sets_of(root, folder=str(folder), **options)
    sets.require(everything(sets))
    return sets


def glowing() -> Group:
    material = principled(
        base_color=(0.2, 0.4, 0.6), emission_color=(1, 2, 3), emission_strength=1.0, alpha=0.5
    )
    return nested(2, materials=(material,))


@pytest.mark.parametrize("make", [nested, glowing])
def test_what_is_kept_is_not_made_again(tmp_path, make):
    first = filled(make(), tmp_path)
    assert first.made == len(first.built) > 10 and first.loaded == 0
    second = filled(make(), tmp_path)
    assert second.made == 0 and second.loaded == len(second.built) == len(first.built)
    same(first, second)
    size = sum(p.stat().st_size for p in tmp_path.rglob("*") if p.is_file())
    assert first.statistics()["sample_set_bytes_written"] == size
    assert second.statistics()["sample_set_bytes_read"] == size
    assert not second.take_warnings() and not list(tmp_path.rglob("*.part"))


def test_one_level_is_one_file(tmp_path):
    sets = sets_of(nested(), folder=str(tmp_path))
    g = index_of(sets, "leaf")
    sets.require([(g, 0)])
    assert [p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*.npz")] == [
        f"{sets.files.key(g)}/0.npz"
    ]


def test_nothing_is_hashed_or_written_without_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sets = sets_of(nested())
    sets.require(everything(sets))
    assert sets.files is None and not list(tmp_path.iterdir()) and not sets.take_warnings()


def test_a_group_is_found_from_another_scene(tmp_path):
    """Its parts have other numbers there, which what its surfels say of their triangles must follow."""
    filled(nested(), tmp_path)
    plain = Group("first", [bumpy(9), bumpy(11)])
    sets = sets_of(Group("all", [], [instance(plain), instance(nested())]), folder=str(tmp_path))
    g = index_of(sets, "root")
    wanted = [pair for pair in everything(sets) if pair[0] == g]
    sets.require(wanted)
    assert sets.loaded == len(wanted) and sets.made == 0
    again = sets_of(Group("all", [], [instance(plain), instance(nested())]))
    again.require(wanted)
    for pair in wanted:
        one, two = (s.surfels.source[slice(*s.built[pair])] for s in (sets, again))
        np.testing.assert_array_equal(one, two)
        assert one[:, 0].min(initial=9) >= 2


def keys(root: Group, **how) -> dict[str, str | None]:
    files = SetFiles("unused", compile_geometry(Scene(root)), tuple(how.items()))
    return {group.name: files.key(g) for g, group in enumerate(files.geometry.groups)}


def textured(pixels: np.ndarray, **values) -> Material:
    nodes = {
        "image": Node("tex_image", {}, {"image": Image("image", pixels, **values)}),
        "bsdf": Node("principled", {"base_color": Link("image", "color")}),
    }
    return Material("textured", Graph(nodes, surface=Link("bsdf", "bsdf")))


def test_keys_change_with_all_that_decides_sets_and_with_nothing_else():
    pixels = np.zeros((4, 4, 4), np.uint8)

    def scene(**values) -> Group:
        mesh = bumpy(8, materials=(values.get("material") or textured(pixels.copy()),))
        mesh.uvs["uv"] = values.get("uv", np.zeros((len(mesh.triangles), 3, 2), np.float32))
        mesh.normals = values.get("normals")
        mesh.positions = mesh.positions + np.float32(values.get("shift", 0.0))
        mesh.triangles = np.roll(mesh.triangles, values.get("roll", 0), axis=0)
        leaf = Group("leaf", [mesh])
        batch = instance(leaf, np.eye(4) * values.get("scale", 1.0), **values.get("instance", {}))
        return Group("root", [], [batch])

    start = keys(scene())
    assert start == keys(scene()) and start["leaf"] != start["root"]
    count = len(bumpy(8).triangles)
    other = pixels.copy()
    other[2, 1, 0] = 7
    for values in (
        {"material": textured(other)},
        {"material": textured(pixels, colorspace="Linear")},
        {"material": principled(base_color=(0, 0, 0))},
        {"uv": np.ones((count, 3, 2), np.float32)},
        {"normals": np.ones((count, 3, 3), np.float32)},
        {"shift": 1e-3},
        {"roll": 1},
    ):
        changed = keys(scene(**values))
        assert changed["leaf"] != start["leaf"] and changed["root"] != start["root"]
    # of an instance: where it is and whether a camera sees it; not what else it says
    moved, hidden = keys(scene(scale=2.0)), keys(scene(instance={"visibility": SHADOW}))
    assert moved["leaf"] == hidden["leaf"] == start["leaf"]
    assert len({moved["root"], hidden["root"], start["root"]}) == 3
    assert (
        keys(scene(instance={"object_index": 3, "seed": 5, "visibility": VISIBLE}))["leaf"] == start["leaf"]
    )
    assert keys(scene(), strategy="random")["leaf"] != start["leaf"]


def test_names_and_the_order_of_the_scene_do_not_matter():
    def two(*order) -> Group:
        groups = [Group("a", [replace(bumpy(8), name=f"mesh {order}")]), Group("b", [bumpy(9)])]
        return Group("root", [], [instance(groups[i]) for i in order])

    first, second = keys(two(0, 1)), keys(two(1, 0))
    assert (first["a"], first["b"]) == (second["a"], second["b"])
    assert first["root"] != second["root"]


def test_another_version_of_the_engine_has_files_of_its_own(monkeypatch):
    start = keys(nested(1))
    monkeypatch.setattr(set_files, "_code", lambda: b"another")
    assert not set(start.values()) & set(keys(nested(1)).values())


def test_keys_are_the_same_in_every_process():
    code = (
        "from tests.engine.test_set_files import keys; from tests.engine.test_sample_sets import nested;"
        "print(sorted(keys(nested(1)).items()))"
    )
    found = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, "PYTHONHASHSEED": "7"}, cwd=Path(__file__).parents[2],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert found.stdout.strip() == str(sorted(keys(nested(1)).items()))


def test_options_have_files_of_their_own(tmp_path):
    root = Group("root", [bumpy(16)])
    filled(root, tmp_path)
    for options in ({"strategy": "random"}, {"seed": 1}, {"strategy": "random", "failure": 0.1}):
        other = filled(root, tmp_path, **options)
        assert other.loaded == 0 and other.made > 0
    assert filled(root, tmp_path, failure=0.1).made == 0  # random sampling alone can fail


# What goes wrong


def damage(path: Path, how: str) -> None:
    data = path.read_bytes()
    if how == "truncated":
        path.write_bytes(data[: len(data) // 2])
    elif how == "flipped":
        middle = len(data) // 2
        path.write_bytes(data[:middle] + bytes([data[middle] ^ 255]) + data[middle + 1 :])
    elif how == "empty":
        path.write_bytes(b"")
    elif how == "text":
        path.write_text("not sample sets")
    elif how == "foreign":
        np.savez(path, row=np.zeros(3))
    else:
        with np.load(path) as file:
            arrays = dict(file)
        if how == "counts":
            arrays["counts"] = arrays["counts"][:-1]
        elif how == "parts":
            arrays["source"] = arrays["source"] + np.int32(5)
        elif how == "nan":
            arrays["row"][0, 0] = np.nan
        np.savez(path, **arrays)


@pytest.mark.parametrize(
    "how", ["truncated", "flipped", "empty", "text", "foreign", "counts", "parts", "nan"]
)
def test_damaged_files_are_named_and_made_anew(tmp_path, how):
    root = Group("root", [bumpy(20)])
    first = filled(root, tmp_path)
    path = max(tmp_path.rglob("*.npz"), key=lambda p: p.stat().st_size)
    damage(path, how)
    second = filled(root, tmp_path)
    assert second.made == 1 and second.loaded == first.made - 1
    same(first, second)
    [warning] = second.take_warnings()
    assert str(path) in warning and not second.take_warnings()
    assert filled(root, tmp_path).made == 0


def test_a_folder_that_cannot_be_written_is_a_warning(tmp_path):
    (tmp_path / "file").write_text("")
    sets = filled(Group("root", [bumpy(16)]), tmp_path / "file")
    assert sets.made == len(sets.built) > 0 and sets.loaded == 0
    warnings = sets.take_warnings()
    assert warnings and all("could not be written" in w for w in warnings)


def test_materials_without_content_are_made_and_not_kept(tmp_path):
    material = principled()
    material.graph.nodes["bsdf"].params["unknown"] = object()
    sets = filled(Group("root", [bumpy(16, materials=(material,))]), tmp_path)
    assert sets.made == len(sets.built) > 0 and not list(tmp_path.iterdir())
    assert "root" in sets.take_warnings()[0]


# Through render


def test_images_from_kept_sets(tmp_path):
    scene = lit_floor(bumpy(80, materials=(principled(base_color=(0.8, 0.2, 0.2)),)))
    options = ForwardSettings(shading="simple", shadows=False)
    settings = RenderSettings(width=32, height=24, method="forward", forward=options)
    plain = render(scene, settings)
    settings.forward = replace(options, cache_folder=str(tmp_path / "sets"))
    first, second = render(scene, settings), render(scene, settings)
    assert plain.stats["needs"]["sample_sets_made"] == first.stats["needs"]["sample_sets_made"] > 0
    assert first.stats["needs"]["sample_sets_loaded"] == second.stats["needs"]["sample_sets_made"] == 0
    assert second.stats["needs"]["sample_sets_loaded"] > 0
    for frame in (first, second):
        np.testing.assert_array_equal(frame.passes["combined"], plain.passes["combined"])
    damage(next((tmp_path / "sets").rglob("*.npz")), "text")
    third = render(replace(scene), settings)
    assert any("damaged" in w for w in third.warnings)


def test_a_group_without_sets_has_no_files(tmp_path):
    sets = filled(
        Group("root", [], [Instances((Group("flat", []),), random_transforms(np.random.default_rng(0), 3))]),
        tmp_path,
    )
    assert (sets.sets[:, 0] == NEVER).all() and not list(tmp_path.iterdir())
