"""A csv is played as it stands: its positions, its duration, its joints by name; what is wrong with it is one line."""

import numpy as np
import pytest

from invdyn_cli.errors import UsageError
from invdyn_cli.simulation.plant import simulate
from invdyn_cli.simulation.played import Played, write_csv
from invdyn_cli.simulation.references import Multisine


@pytest.fixture
def played(tmp_path, apollo4):
    """A file of 4 s at 100 Hz, and the motion that it was made from."""
    motion = Multisine(speed=0.4, amplitude=0.4, base=0.25).motion(apollo4, 4.0, 100.0, seed=3)
    path = tmp_path / "way.csv"
    write_csv(path, np.arange(400) / 100.0, np.asarray(motion.q), apollo4.joints)
    return path, motion


def test_gives_the_motion_that_was_written(played, apollo4):
    """At the file's own rate positions are the file's, to its nine digits, and velocities those of the motion, to the
    error of a quintic spline through points 10 ms apart."""
    path, motion = played
    again = Played(str(path)).motion(apollo4, 30.0, 100.0, seed=0)
    assert np.abs(again.q - motion.q).max() < 1e-8
    assert np.abs(again.qd - motion.qd).max() < 1e-4 * np.abs(motion.qd).max()


def test_the_file_decides_how_long_it_takes(played, apollo4):
    """Whatever duration is asked for, shorter or longer, the whole file is played."""
    for duration in (1.0, 60.0):
        assert len(Played(str(played[0])).motion(apollo4, duration, 1000.0, seed=0)) == 3991


def test_columns_are_found_by_name(played, tmp_path, apollo4):
    """The order of the columns does not matter, nor does one that no joint has."""
    table = np.loadtxt(played[0], delimiter=",", skiprows=2)
    turned = tmp_path / "turned.csv"
    head = ",".join(("mood", *apollo4.joints[::-1], "t"))
    np.savetxt(turned, np.column_stack([table[:, 0] * 0, table[:, :0:-1], table[:, 0]]), delimiter=",", header=head,
               comments="", fmt="%.9f")  # fmt: skip
    one, other = (Played(str(x)).motion(apollo4, 1.0, 100.0, 0) for x in (played[0], turned))
    assert np.allclose(one.q, other.q, atol=1e-9)


def test_the_plant_follows(played, apollo4):
    """The simulated arm plays the file for its own 4 s, within a hundredth of a radian."""
    raw = simulate(apollo4, Played(str(played[0])), duration=1.0, rate=500.0)
    assert raw.t[-1] == pytest.approx(3.99, abs=0.003)
    assert np.abs(raw.q - raw.q_ref).max() < 0.01


def test_misuse_is_one_line(played, tmp_path, apollo4):
    """No file, no joint, no number, a clock that stands still, a joint beyond its limit or too fast: what was got."""
    text = played[0].read_text()
    name = apollo4.joints[1]
    rows = text.splitlines()
    high = float(np.asarray(apollo4.upper)[1]) + 0.5
    far = [f"{k * 10.0},0,{high * np.sin(0.2 * k):.6f},0,0" for k in range(30)]
    fast = [f"{k * 0.1},0,{0.3 * np.sin(1.5 * k):.6f},0,0" for k in range(30)]
    for content, word in (
        (text.replace(name, "elbow"), f"0 columns '{name}'"),
        (text + "1,2,three,4,5\n", "three"),
        (text + rows[-1] + "\n", "increasing times"),
        ("\n".join(rows[:4]), "6 rows or more"),
        ("\n".join([rows[1], *far]), "goes from"),
        ("\n".join([rows[1], *fast]), "per second"),
    ):
        path = tmp_path / "wrong.csv"
        path.write_text(content)
        with pytest.raises(UsageError, match=word) as error:
            Played(str(path)).motion(apollo4, 1.0, 100.0, 0)
        assert "\n" not in str(error.value)
    with pytest.raises(UsageError, match=r"none\.csv"):
        Played(str(tmp_path / "none.csv")).motion(apollo4, 1.0, 100.0, 0)
