"""What users install: the wheel holds everything, and works from an empty folder without the checkout."""

import zipfile
from pathlib import Path

import pytest

from tests.commands import ROOT, TINY, python, script


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """The wheel, built from the checkout."""
    out = tmp_path_factory.mktemp("wheel")
    built = python("-m", "build", "--wheel", "--no-isolation", "--outdir", str(out), str(ROOT), cwd=out)
    assert built.returncode == 0, built.stderr + built.stdout
    [path] = out.glob("*.whl")
    return path


def test_holds_configs_experiments_and_robots(wheel):
    """conf/, experiments/ and the built-in robot are inside the package, each file as in the checkout."""
    with zipfile.ZipFile(wheel) as archive:
        held = set(archive.namelist())
        assert {"invdyn_cli/apollo_arm.urdf", "invdyn_cli/report/plots.js", "invdyn_cli/report/plots.css"} <= held
        for folder in ("conf", "experiments"):
            files = [p for p in (ROOT / folder).rglob("*") if p.is_file() and "__pycache__" not in p.parts]
            assert files
            for path in files:
                name = f"invdyn_cli/{path.relative_to(ROOT)}"
                assert archive.read(name) == path.read_bytes()
    assert not [name for name in held if name.startswith(("tests/", "outputs/", "conf/"))]


def test_works_from_an_empty_folder(wheel, tmp_path):
    """Installed elsewhere, `invdyn run` works in an empty folder, with the wheel's own code and configs, and so does an
    experiment of the wheel, in processes of its own."""
    installed, empty = tmp_path / "installed", tmp_path / "empty"
    empty.mkdir()
    done = python("-m", "pip", "install", "--quiet", "--no-deps", "--target", str(installed), str(wheel), cwd=empty)
    assert done.returncode == 0, done.stderr
    code = "from invdyn_cli.verbs.listing import config_folder, path_of; print(config_folder(), path_of('gear_play'))"
    where = python("-c", code, cwd=empty, PYTHONPATH=str(installed))
    configs, experiment = map(Path, where.stdout.split())
    assert configs == installed / "invdyn_cli" / "conf" and experiment.is_relative_to(installed)
    done = python(script(installed / "bin"), "run", "model=pest", *TINY, cwd=empty, PYTHONPATH=str(installed))
    assert done.returncode == 0, done.stderr
    assert (empty / done.stdout.splitlines()[-1] / "metrics.json").is_file()
    argv = ("experiment", "gear_play", "workers=2")
    done = python("-P", script(installed / "bin"), *argv, cwd=empty, PYTHONPATH=str(installed))
    assert done.returncode == 0, done.stderr
    assert (empty / "outputs" / "gear_play" / "gear_play.png").is_file()
