"""The experiments' own bookkeeping: what is counted as found, where a climb ends, what a command line may say."""

import json
from dataclasses import dataclass

import pytest
from hydra import compose, initialize_config_dir

from experiments.bench import PARTS
from experiments.detection import ENOUGH, HIGHEST, STEP, climb, is_found
from experiments.excite import Settled, least_distance, open_finding
from experiments.excite import table as excite_table
from experiments.marked import put
from experiments.multiple import Counted, f1
from experiments.options import only_of, options_of
from experiments.real_diagnosis import JOBS
from experiments.replay import NOT_HELD, Replayed, names_of
from experiments.replay import table as replay_table
from experiments.worn import spoken
from invdyn_cli.simulation.hidden import Hidden
from invdyn_cli.types import Diagnosis, Examination, Finding
from invdyn_cli.verbs.launch import config_folder
from tests.commands import ROOT, python


@pytest.mark.parametrize("first", [0.0005, 0.4])
def test_a_climb_ends_at_the_smallest_size_that_enough_logs_show(first):
    """From below or above, the share found is on the ladder, is shown by 9 of 10 logs, and the next below is not."""
    limits = [0.01 * (1 + 0.1 * k) for k in range(9)] + [1.0]

    def found(share: float, log: int) -> bool:
        return share >= limits[log]

    share, tried = climb(found, first, 10)
    assert share is not None and limits[8] <= share < limits[8] * STEP
    assert all(hits <= asked <= 10 for _, hits, asked in tried)
    assert not [size for size, hits, _ in tried if size < share and hits >= ENOUGH * 10]


def test_a_climb_gives_up_cheaply():
    """What no log shows costs two logs a size, and has no limit."""
    share, tried = climb(lambda share, log: False, 0.1, 10)
    assert share is None
    assert {asked for _, _, asked in tried} == {2} and tried[-1][0] <= HIGHEST


def test_a_large_friction_is_found():
    """A friction of a fifth of the joint's torque is found by the experiment's own means."""
    assert is_found("coulomb_friction", 0.2, 0.003, 0, 0)


def test_f1_counts_pairs():
    """Two of three found and one claim beside them: precision and recall 2/3."""
    one = Counted("three", 0, ("a@1", "b@2", "c@3"), ("a@1", "b@2", "d@3"), ("c@3",), ("d@3",), 1.0)
    assert f1([one]) == pytest.approx((2 / 3, 2 / 3, 2 / 3))


def test_a_standard_term_is_no_anomaly():
    """Of a worn arm a friction's claim is no anomaly, nor is one that a friction explains as well; another is, and only
    the right one is right."""
    hidden = Hidden("joint_spring", "a", {"stiffness": 1.0, "rest": 0.0})
    friction = Finding("coulomb_friction", "b", "named")
    either = Finding("actuator_lag", "b", "ambiguous", (("viscous_friction",),))
    false, right = Finding("torque_delay", "b", "named"), Finding("joint_spring", "a", "named")
    assert spoken(hidden, [friction, either, right]) == ("named", [])
    assert spoken(hidden, [friction, false]) == ("missed", [false])
    assert spoken(None, [right]) == ("none", [right])


def test_every_part_of_the_benchmark_runs(tmp_path):
    """With few samples: a part prints a ratio, or what has to be installed for it."""
    done = python(str(ROOT / "experiments" / "bench.py"), "--tiny", "--json", "bench.json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    parts = json.loads((tmp_path / "bench.json").read_text())["parts"]
    assert len(parts) == len(PARTS) and all(x.get("ratio", 0) > 0 or "torch" in x["skipped"] for x in parts.values())


def test_replays_are_counted():
    """Two different effects that an MJCF holds are drawn for a log; a log counts from 80 % on."""
    for k in range(30):
        one, other = names_of(0, k)
        assert one != other and not {one, other} & set(NOT_HELD)
    logs = [Replayed(0, ("a@1", "b@2"), (), 1.0, after, 0.1, 1.0, 1.0, 1.0) for after in (0.1, 0.2, 0.3, 1.5)]
    assert "2 of 4 logs" in replay_table(logs) and "| -50 % |" in replay_table(logs)


def test_open_cases_are_those_that_hold_the_hidden_effect():
    """A case is an ambiguous finding with the hidden effect among its names; its distance is the smallest from a rival
    where that effect is the true one, and there is none where no motion tells one of them."""
    hidden = Hidden("actuator_lag", "j2", {"time_constant": 0.01})
    pairs = [
        {"true": "torque_delay", "rival": "actuator_lag", "standard_errors": 3.0, "possible": True},
        {"true": "actuator_lag", "rival": "torque_delay", "standard_errors": 20.0, "possible": True},
    ]
    late = Finding("torque_delay", "j2", "ambiguous", (("actuator_lag",),), evidence={"distances": pairs})
    elsewhere = Finding("torque_delay", "j1", "ambiguous", (("actuator_lag",),))
    said = Diagnosis("explained", Examination(True, (), {}), (elsewhere, late), {}, {}, None, {})
    assert open_finding(hidden, said) == 1
    assert open_finding(Hidden("joint_spring", "j2"), said) is None
    assert least_distance(hidden, late) == 20.0
    never = Finding("torque_delay", "j2", "ambiguous", evidence={"distances": [{**pairs[1], "possible": False}]})
    assert least_distance(hidden, never) is None


def test_the_count_is_of_right_names():
    """Of two cases one is named rightly."""
    rows = [Settled(k, "a@j", ("a|b@j",), 20.0, ("a@j",), how, 1.0) for k, how in ((0, "named"), (1, "ambiguous"))]
    assert "1 of 2 ambiguous cases are named rightly" in excite_table(rows, [], 5)


@dataclass(frozen=True)
class _Options:
    seed: int = 0
    noises: tuple[float, ...] = (0.1,)
    docs: bool = False


def test_options_are_read_and_wrong_ones_refused(capsys):
    """name=value as the defaults' types have it; anything else ends with one line and exit code 2."""
    assert options_of(["seed=3", "noises=0.1,2", "docs=true"], _Options(), None) == _Options(3, (0.1, 2.0), True)
    for wrong in ("sed=3", "seed=x", "docs=yes", "seed"):
        with pytest.raises(SystemExit) as stopped:
            options_of([wrong], _Options(), None)
        assert stopped.value.code == 2 and len(capsys.readouterr().err.splitlines()) == 1
    with pytest.raises(SystemExit):
        only_of("only", ["c"], "ab")


def test_results_are_put_between_markers(tmp_path):
    """Only what stands between the markers changes; a page without them is refused."""
    page = tmp_path / "page.md"
    page.write_text("a\n<!-- x -->\nold\n<!-- /x -->\nb\n")
    put(page, "x", "new\n")
    assert page.read_text() == "a\n<!-- x -->\nnew\n<!-- /x -->\nb\n"
    with pytest.raises(ValueError):
        put(page, "y", "new")


@pytest.mark.parametrize("page, name", [("docs/diagnosis.md", "detection"), ("experiments/real_diagnosis.md", "found")])
def test_pages_have_the_markers_that_are_written(page, name, tmp_path):
    """What `make detection` and `make real-diagnosis` write in place has its place."""
    copy = tmp_path / "page.md"
    copy.write_text((ROOT / page).read_text())
    put(copy, name, "new")


@pytest.mark.parametrize("name", JOBS)
def test_real_diagnoses_compose(name):
    """The overrides of every real diagnosis are options of invdyn diagnose."""
    with initialize_config_dir(str(config_folder()), version_base="1.3"):
        compose("diagnose", ["data=real_log", "data.path=x.h5", *JOBS[name].overrides])
