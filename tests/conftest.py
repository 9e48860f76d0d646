"""Strictness for all tests (the numerical modules' annotations are checked as they run), and what several share.

`jax_numpy_rank_promotion="raise"` is not set: a number per joint meets rows of samples all over `rigid_body`.
"""

import os
from pathlib import Path

import pytest
from beartype import BeartypeConf
from beartype.claw import beartype_packages

CHECKED = ("maths", "training", "experiment", "store", "adaptation")
beartype_packages([f"invdyn_cli.{name}" for name in CHECKED], conf=BeartypeConf(is_pep484_tower=True))


@pytest.fixture(scope="session")
def apollo4():
    """The paper's reduced arm: the upper four joints."""
    from invdyn_cli.robots import load_urdf

    return load_urdf("apollo_arm", dofs=4)


@pytest.fixture(scope="session")
def real_data():
    """Gives the path of a file among the logs and URDFs of real robots, or skips the test with a word."""
    folder = Path(os.environ.get("INVDYN_REAL_DATA", Path(__file__).parents[2] / "shared" / "data"))

    def path(name: str) -> Path:
        if not (folder / name).exists():
            pytest.skip(f"no {name}: set INVDYN_REAL_DATA to a folder with the development logs")
        return folder / name

    return path
