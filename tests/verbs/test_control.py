"""invdyn control: its files, its words, and what it refuses."""

import csv
import json
from pathlib import Path

import pytest

SMALL = ("robot.dofs=2", "data.repetitions=1", "data.watched=0", "data.friction=0", "data.elastic=false")
TINY = (*SMALL, "data.ripple=0", "data.torque_noise=0.01", "gains=[20]", "settle=0.2", "model=pest")


def test_leaves_its_files(command):
    """The last line is the folder with control.json, control.csv, page and figure; the JSON has every run with each
    joint, and with the object the adapted one is the closest; the table's lines have the gain."""
    said = command("control", *TINY)
    assert (said.code, said.err) == (0, [])
    folder = Path(said.out[-1])
    assert folder.parts[:2] == ("outputs", "control") and folder.name.endswith("pest-pick_place-payload-seed0")
    names = {p.name for p in folder.iterdir() if p.name[0] != "."}
    assert names == {"control.json", "control.csv", "report.html", "figures"}
    assert [p.name for p in (folder / "figures").iterdir()] == ["control.png"]
    made = json.loads((folder / "control.json").read_text())
    assert (made["schema"], made["model"], made["adaptation"]) == ("invdyn-control/1", "pest", "payload")
    kinds = ("feedback_alone", "as_learned", "adapted")
    assert [(x["object"], x["feedforward"]) for x in made["cases"]] == [(o, k) for o in (False, True) for k in kinds]
    for one in made["cases"]:
        assert set(one["error_deg"]["joint"]) == set(made["joints"]) == {"arm_joint_1", "arm_joint_2"}
        assert 0 < one["error_deg"]["rms"] <= one["error_deg"]["peak"]
        assert set(one["stages_deg"]) == {"approach", "grasp", "place", "retract"}
    alone, learned, adapted = (x["error_deg"]["rms"] for x in made["cases"][3:])
    assert adapted < learned < alone
    rows = list(csv.DictReader((folder / "control.csv").read_text().splitlines()))
    assert [float(x["error_deg"]) for x in rows] == [x["error_deg"]["rms"] for x in made["cases"]]
    text = "\n".join(said.out)
    assert all(
        word in text for word in ("[deg]", "feedback alone", "not adapted", "adapted", "With the object, gain 20")
    )


def test_adaptations_are_slower_in_a_loop_unless_asked_for(command):
    """In a loop payload follows no disturbance and nets go on at 1e-5; a word on the command line wins."""
    for overrides, shown in (
        ((), "  observer: null"),
        (("adaptation.observer=10",), "  observer: 10"),
        (("adaptation=incremental", "model=ffnn_deep"), "  learning_rate: 1.0e-05"),
        (("adaptation=incremental", "adaptation.learning_rate=0.02"), "  learning_rate: 0.02"),
        (("adaptation=error_model",), "    learning_rate: 1.0e-05"),
    ):
        said = command("control", "--cfg", "job", *overrides)
        assert said.code == 0
        assert shown in said.out
    assert command("control", "--cfg", "job", "adaptation=batch").code == 0
    assert "  observer: 10" in command("run", "--cfg", "job", "adaptation=payload").out


@pytest.mark.parametrize(
    ("overrides", "word"),
    [
        (("data=sim_noisy",), "data=pick_place"),
        (("gains=[10,-1]",), "gains=[10"),
        (("gains=5",), "gains=5; allowed: a list"),
        (("gians=[5]",), "did you mean 'gains'"),
        (("repetitions=x",), "a whole number"),
        (("data.decimate=5",), "data.decimate=5"),
        (("adaptation=null",), "adaptation=null; allowed"),
        (("seed=-1",), "seed=-1"),
        (("model=pest", "adaptation=incremental", *TINY[:-1]), "ffnn_deep"),
    ],
)
def test_misuse_is_one_line(command, overrides, word):
    """What cannot be done is refused in one line with what is allowed; exit code 2."""
    said = command("control", *overrides)
    assert said.code == 2
    assert len(said.err) == 1 and word in said.err[0]
