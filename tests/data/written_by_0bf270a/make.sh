#!/bin/sh
# make.sh OUT: writes these files anew into the empty folder OUT, with the tailbeat of commit 0bf270a.
# Its .venv/bin comes first in PATH. A shell script, because the imports in it are those of 0bf270a.
set -eu
mkdir -p "$1"
cd "$1"
export XDG_DATA_HOME="$PWD/scratch/data" XDG_CONFIG_HOME="$PWD/scratch/config"
export TAILBEAT_LOGBOOK="$PWD/library" TAILBEAT_KEYS="$PWD/keys"
python - <<'PYTHON'
import contextlib, gzip, io, json, shutil, subprocess
from pathlib import Path

import numpy as np

from tailbeat import fish as fish_module
from tailbeat import keys, records
from tailbeat.cli import run
from tailbeat.day.repeat import Plan
from tailbeat.experiment import Experiment
from tailbeat.experiment.analysis import analyse
from tailbeat.experiment.board import held_state
from tailbeat.fish import Fish
from tailbeat.flashing.keep import keep
from tailbeat.logbook import Logbook
from tailbeat.model import lent
from tailbeat.recompute import recompute_beats
from tailbeat.transport.simulated import SimBoard, SimTransport
from tailbeat.trial_log import read_trial

# Away from the default of 0bf270a and of every later commit, and exact in float32.
LAW = {
    "LAW_GAIN": 3.25, "LAW_KD": 0.125, "LAW_LEAD": 1.5, "LAW_TAIL": 2, "LAW_Q_LEN": 3,
    "LAW_FADE": 0.25, "LAW_FADE_FROM": 2, "LAW_KIND": 2, "LAW_WINDOW": 4, "LAW_BEYOND": 1,
    "GLIDE_S": 0.75,
}
expected = {}
board = SimBoard("tank", seed=1)
fish_module.open_transport = lambda url=None, **_: SimTransport(board)


def tailbeat(*words, connect=True):
    """One command; what it prints."""
    said, told = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(told):
        status = run([*words, *(["--connect", "sim:tank"] if connect else [])])
    print(status, " ".join(words), told.getvalue()[-300:].strip() if status else "")
    assert status == 0, words
    return said.getvalue()


def note(name, *words, connect=False):
    """Keeps the JSON that a command prints."""
    expected[name] = {"command": list(words), "json": json.loads(tailbeat(*words, "--json", connect=connect))}


def hexed(values):
    return np.asarray(values, np.float32).tobytes().hex()


def bits(fish):
    """What the board is to swim next, as float32."""
    best = fish.amplitudes(best=True)
    return {
        "next": hexed(fish.amplitudes().values),
        "best": hexed(best.values),
        "visits": [int(n) for n in fish.visits()],
        "iteration": fish.status().iteration,
    }


def made(since):
    (new,) = set(Path("series").iterdir()) - since
    return str(new)


def swim(*words):
    tailbeat("trial", "run", "--rest", "1", *words)


# files that people write
Path("hill.csv").write_text("t_s,v_m_s\n0,0\n2,0.05\n5,0.075\n8,0.05\n10,0.02\n")
Path("slow.csv").write_text("t_s,v_m_s\n0,0\n2.4,0.045\n6,0.0675\n9.6,0.045\n12,0.018\n")
Path("steady.csv").write_text("amplitude_rad,speed_m_s\n0.1,0.018\n0.2,0.036\n0.3,0.052\n0.45,0.07\n0.6,0.084\n")
Path("law.json").write_text(json.dumps({"kp_rad_s_m": 3.25, "kd_rad_s2_m": 0.125, "lead_beats": 1.5, "tail": "hold-new",
    "q_len": 3, "fade": 0.25, "fade_from": 2, "amplitude_max_rad": 0.7, "step_max_rad": 0.1}, indent=1) + "\n")
Path("law-params.json").write_text(json.dumps({k: v for k, v in LAW.items() if k not in
    ("LAW_KIND", "LAW_WINDOW", "LAW_BEYOND", "GLIDE_S")}, indent=1) + "\n")
Path("input.csv").write_text("beat,amplitude_rad\n0,0.2\n1,0.3\n2,0.4\n3,0.35\n4,0.3\n5,0.2\n")
Path("error.csv").write_text("beat,error_m_s\n0,0.01\n1,0.02\n2,\n3,-0.01\n4,0.005\n5,0.002\n")
Path("tiny.toml").write_text("""title = "Two fish"
reference = "cosine:0.06,3,2"
iterations = 2
seeds = 2

[[plant]]
kappa_per_m = [5, 10]

[[law]]
name = "lead 1"
kind = "p"
lead_beats = 1

[[claim]]
text = "median of the last trial at most 60 mm/s"
statistic = "median"
where = { law = "lead 1" }
iteration = -1
at_most = 0.06
""")

# the day at the tank: two experiments along one reference
for name, value in {"LAW_LEAD": 1, "AMP_MAX_RAD": 0.7, "TANK_LEN_M": 0}.items():
    tailbeat("params", "set", name, str(value))
tailbeat("reference", "upload", "hill.csv")
tailbeat("identify", "--table", "steady.csv", "--out", "identified-table.json")
tailbeat("identify", "--yes", "--rest", "1")
A = ["experiment", "new", "--reference", "hill.csv", "--fish", "carangi", "--water-temp", "21.5",
     "--condition", "water_depth_m=0.35", "--operator", "somebody", "--configuration", "silicone tail",
     "--root", "series"]
tailbeat(*A)
a = made(set())
swim("--then", "keep", "--until", "2")
swim("--then", "discard", "--reason", "bumped the wall")
swim("--then", "keep", "--until", "2")
swim("--then", "repeat", "--reason", "once more for the noise")
tailbeat("experiment", "note", "the water is clear")
tailbeat("experiment", "set", "--condition", "salinity_psu=0.3")
for name, value in LAW.items():
    tailbeat("params", "set", name, str(value))
tailbeat("params", "save")
for again in ("slow.csv", "hill.csv"):  # another reference and back: it learns anew
    tailbeat("reference", "upload", again)
tailbeat("experiment", "new", "--reference", "hill.csv", "--fish", "carangi", "--water-temp", "22", "--another",
         "--root", "series")
b = made({Path(a)})
swim("--then", "keep", "--until", "5")
tailbeat("identify", "--experiment", a, "--out", "identified.json")
with Fish.connect("sim") as fish:
    expected["learned"] = bits(fish)
    Path("learned.bin").write_bytes(fish.learned_record())
    Path("reference.bin").write_bytes(fish.reference_record())
    past = {f"past{n}.bin": fish.past_record(f"/past{n}.bin") for n in range(8)}
    for name, content in past.items():
        if content is not None:
            Path(name).write_bytes(content)
    kept = keep(fish, Path("backup"), lambda *_: None)
    shutil.rmtree(kept.folder / "trials", ignore_errors=True)

# another reference, by hand, with speeds measured elsewhere, then the model's law
tailbeat("reference", "upload", "slow.csv", "--like", "board")
tailbeat("trial", "run", "--no-guide")
with Fish.connect("sim") as fish:
    number = fish.status().pending_trial or fish.status().next_trial - 1
tailbeat("trial", "pull", str(number), "--into", "trials")
(log,) = Path("trials").glob("*.ulg")
speeds = read_trial(log).beats.speed_m_s
rows = "".join(f"{at},{v + 0.001:.5f}\n" for at, v in enumerate(speeds))
Path("speed.csv").write_text("beat,speed_m_s\n" + rows)
tailbeat("speed", "upload", str(number), "speed.csv", "--sigma", "0.002")
tailbeat("trial", "pull", str(number), "--into", "trials-with-speeds")
tailbeat("learn", str(number))
tailbeat("trial", "run", "--no-guide")
tailbeat("learn", "--law", "model")
tailbeat("reference", "show", "--csv", "reference.csv")
tailbeat("trial", "show", str(log), "--csv", "beats.csv", connect=False)
note("progress_references", "progress", "--reference", "list", connect=True)
for at, one in enumerate(expected["progress_references"]["json"]["references"]):
    del one["last"]  # the time of the copy on this disk
    note(f"progress_reference_{at}", "progress", "--reference", f"{one['reference_crc']:#010x}", connect=True)

# what procedures that were broken off leave behind
shutil.copytree(b, "left-behind/experiment", ignore=shutil.ignore_patterns("raw", "report", "export"))
with Fish.connect("sim") as fish:
    Plan(Path("learned.bin").read_bytes(), 11).write(Experiment.open(Path("left-behind/experiment")))
    put_back, lent._put_back = lent._put_back, lambda *_: None
    with lent.lent(fish, Path("left-behind/board"), lambda _: None, "trim") as lended:
        lended.prepare("a run", np.full(4, 0.1, np.float32), [0.02, 0.05, 0.05, 0.02])
    lent._put_back = put_back

# a fresh board's storage
board = SimBoard("tank", seed=2)
for name, value in {**LAW, "AMP_MAX_RAD": 0.7, "TANK_LEN_M": 0}.items():
    tailbeat("params", "set", name, str(value))
tailbeat("params", "save")
with Fish.connect("sim") as fish:
    fish.upload_reference(records.encode_reference(1.0, [0.03, 0.06, 0.07, 0.06, 0.03]))
    for _ in range(3):
        fish.learn(fish.run_trial().number)
    fish.arm()
    fish.disarm()
    expected["store"] = {
        "params": {name: p.value for name, p in fish.params.list().items()},
        "reference": fish.reference_record().hex(),
        "learned": fish.learned_record().hex(),
        **bits(fish),
        "next_trial": fish.status().next_trial,
        "past": {n: (fish.past_record(f"/past{n}.bin") or b"").hex() for n in range(8)},
    }
    store = board.flash
Path("store.bin.gz").write_bytes(gzip.compress(store, 9, mtime=0))
board = SimBoard("tank", seed=2)
board.flash = store
board.power_cycle()
with Fish.connect("sim") as fish:
    fish.link.run(3.0)
    number = fish.run_trial().number
    fish.upload_speeds(number, [0.02, 0.05, 0.065, 0.06, 0.035], [0.001] * 5)
    fish.learn(number)
    expected["store"]["after_one_more"] = bits(fish)

# camera
Path("scratch").mkdir(exist_ok=True)
tailbeat("camera", "render", "scratch/film.mp4", "--reference", "cosine:0.06,2,1", connect=False)
shutil.copy(next(iter(Path("scratch").glob("*.json"))), "tank.json")
film_log = next(iter(Path("scratch").glob("*.ulg")))
tailbeat("camera", "track", "scratch/film.mp4", "--calibration", "tank.json", "--trial", str(film_log),
         "--out", "track", connect=False)

# studies and keys
subprocess.run(["tailbeat", "sweep", "tiny.toml", "--out", "sweep", "--cores", "1"], check=True)  # it starts processes
with Fish.connect("sim") as fish:
    keys.KeyStore().save(keys.StoredKey(bytes(range(1, 33)), fish.unique_id(), "throw-away",
        "2026-01-01T00:00:00+00:00", 7, 1000, 2000))
tailbeat("key", "export", "fish.key", connect=False)

# what 0bf270a makes of all that
book = Path("library", next(iter(Path("library").iterdir())).name)
for name, folder in (("a", a), ("b", b)):
    tailbeat("report", folder, connect=False)
    tailbeat("experiment", "export", folder, "--format", "csv", connect=False)
    shutil.rmtree(f"{folder}/report")  # large, and made again; analysis.json stays
    note(f"replay_{name}", "experiment", "replay", folder)
    note(f"show_{name}", "experiment", "show", folder)
    note(f"progress_{name}", "progress", "--experiment", folder)
    experiment = Experiment.open(Path(folder))
    analysis = analyse(experiment)
    expected[f"bits_{name}"] = [
        {"trial": t.number, "iteration": t.iteration, "amplitude_rad": hexed(t.beats.amplitude_rad),
         "speed_m_s": hexed(t.beats.speed_m_s), "recomputed_m_s": hexed(recompute_beats(t)[0])}
        for t in analysis.trials
    ]
    held = held_state(experiment)
    expected[f"held_{name}"] = {"params": held.params, "iteration": held.iteration,
        "reference": held.reference.hex(), "learned": held.learned.hex()}
note("compare", "experiment", "compare", a, b, "--iterations", "2,3,4,5")
note("list", "experiment", "list", "--root", "series")
for at, path in enumerate([log, *Path("trials-with-speeds").glob("*.ulg")]):
    note(f"trial_{at}", "trial", "show", str(path), *([] if at else ["--recompute"]))
for name in ("law", "law-params"):
    note(name, "law", "--config", f"{name}.json", "--input", "input.csv", "--error", "error.csv")
note("design", "design", "--identified", "identified.json", "--reference", "hill.csv", "--amplitude-max", "0.7")
note("check", "reference", "check", "hill.csv", "--identified", "identified.json", "--amp-max", "0.7", "--tank", "3")
note("sweep", "sweep", "--summary", "sweep")
note("keys", "key", "list")
del expected["keys"]["json"]["folder"]
trials = Logbook(book).kept()[0]
expected["library"] = [
    {"trial": k.trial.number, "mark": k.mark, "reference_crc": k.trial.reference_crc,
     "amplitude_rad": hexed(k.trial.beats.amplitude_rad), "speed_m_s": hexed(k.trial.beats.speed_m_s)}
    for k in trials
]
shutil.rmtree(f"{b}/export")
current = book / "experiment.json"  # the folder of the experiment; nothing of this computer stays in it
current.write_text(current.read_text().replace(f"{Path.cwd()}/", ""))
Path("expected.json").write_text(json.dumps(expected, indent=1, sort_keys=True) + "\n")
PYTHON
rm -rf scratch
