"""The engine stands alone: it never imports Blender, and importing it is quick because no kernel loads."""

import ast
import subprocess
import sys
from pathlib import Path

import pointmr_engine

ENGINE = Path(pointmr_engine.__file__).parent


def imported_names(path: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.add(node.module.split(".")[0])
    return names


def test_no_file_of_the_engine_imports_blender():
    files = list(ENGINE.rglob("*.py"))
    assert len(files) > 50
    guilty = [f.name for f in files if imported_names(f) & {"bpy", "mathutils", "blender_addon", "gpu"}]
    assert guilty == []


def test_importing_the_engine_loads_neither_blender_nor_numba():
    code = "import sys, pointmr_engine; print([m for m in ('bpy', 'numba', 'OpenEXR') if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_imports_run_one_way():
    """scene -> shading -> hierarchy -> raytracing -> forward -> multires; numerics and image serve all.

    Only render.py sees all.

    Forward mapping takes camera, lamps, world and surface attributes from raytracing, but no rays of it.
    """
    may_see = {
        "scene": {"scene"},
        "numerics": {"numerics", "scene"},
        "image": {"image", "scene", "numerics"},
        "shading": {"shading", "scene", "numerics"},
        "hierarchy": {"hierarchy", "shading", "scene", "numerics"},
        "raytracing": {"raytracing", "hierarchy", "shading", "scene", "numerics", "image", "needs"},
        "forward": {"forward", "raytracing", "hierarchy", "shading", "scene", "numerics", "image", "needs"},
    }
    may_see["multires"] = may_see["forward"] | {"multires"}
    wrong = []
    for folder, allowed in may_see.items():
        for path in (ENGINE / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("pointmr_engine."):
                    subject = node.module.split(".")[1]
                    if subject not in allowed:
                        wrong.append(f"{folder}/{path.name} imports {node.module}")
                    if folder == "forward" and node.module.startswith("pointmr_engine.raytracing.walk"):
                        wrong.append(f"{folder}/{path.name} traces rays")
    assert wrong == []
