"""Several devices, of one host or of two, do what one device does."""

import importlib.util
import json
import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
import toy

from gaussray.capture.formats.paired import read_capture
from gaussray.capture.frames import read_encoded
from gaussray.dataset.manifest import write_manifest
from gaussray.render import dataset_files
from gaussray.runtime.devices import (
    DevicesOptions,
    from_primary,
    is_primary,
    items_of_this_process,
    replicate,
    start_devices,
)
from gaussray.scene.store import save_scene
from gaussray.tracer.shard import mesh, mesh_of_hosts


HERE = Path(__file__).parents[1]
# Lists differ in length with who renders first: a code may be rounded the other way.
CODE = 1
DECIBEL = 0.01
# Parameters after the fine stage from one state: the same sums in another order.
SAME = 1e-5
# After both stages: what hardly matters at first, Adam moves by the sign of sums that nearly vanish
# (a step of it: 2e-2).
NEAR = 2e-3
# The Gaussians start as round discs, whose turn about their axis matters not at all.
FREE = ("static.quat", "moving.quat", "header")


def test_a_gpu_compiles_without_triton_where_the_user_does_not_decide(monkeypatch):
    find_spec = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: name == "jax_cuda12_plugin" or find_spec(name)
    )
    found = []
    for given in ("", "--xla_gpu_enable_triton_gemm=true", "--xla_cpu_enable_fast_math=false"):
        monkeypatch.setenv("XLA_FLAGS", given)
        start_devices(DevicesOptions(programs=""))
        found.append(os.environ["XLA_FLAGS"])
    off = "--xla_gpu_enable_triton_gemm=false"
    assert found == [
        off,
        "--xla_gpu_enable_triton_gemm=true",
        f"--xla_cpu_enable_fast_math=false {off}",
    ]


def started(truth, out, verbs, *devices):
    """A process that runs the verbs."""
    env = {k: v for k, v in os.environ.items() if not k.lower().endswith("_proxy")}
    # Compiled as users have it: what saves tests time rounds differently on one device and on two.
    env.pop("XLA_FLAGS", None)
    path = [str(HERE), str(HERE.parent), env.get("PYTHONPATH", "")]
    env |= {"JAX_PLATFORMS": "cpu", "PYTHONPATH": os.pathsep.join(filter(None, path))}
    words = [sys.executable, str(HERE / "verbs.py"), str(truth), str(out), verbs, *devices]
    return subprocess.Popen(
        words, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def ended(*processes):
    """Exit codes and words of processes, when all have ended."""
    try:
        said = [process.communicate(timeout=300) for process in processes]
    finally:
        for process in processes:
            process.kill()
    return [p.returncode for p in processes], said


def two_hosts(truth, out, verbs, *others):
    """Two processes that meet on a port that is free; the second with `others` for words."""
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    meet = ("devices.hosts=2", f"devices.coordinator=localhost:{port}", "devices.count=1")
    return ended(
        started(truth, out, verbs, *meet, "devices.process=0"),
        started(truth, out, verbs, *meet, "devices.process=1", *others),
    )


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    """A paired capture, and in `run` the scene that it shows."""
    folder = toy.write_paired(tmp_path_factory.mktemp("truth"), toy.scene())
    save_scene(folder / "run" / "scene.npz", toy.scene())
    write_manifest(folder / "run" / "cameras.json", toy.records())
    return folder


@pytest.fixture(scope="module")
def one(truth, tmp_path_factory):
    """What one device does, and a run that it did not end."""
    out = tmp_path_factory.mktemp("one")
    code, said = ended(started(truth, out, "break,reconstruct,render,evaluate", "devices.count=1"))
    assert code == [0], said
    return out


def begun(one, out):
    """The folder of what one device has begun: a reconstruction, and one picture of three."""
    shutil.copytree(one / "broken", out / "broken")
    shutil.copytree(one / "film", out / "film")
    kept, *lost = sorted((out / "film" / "images").rglob("*.png"))
    for path in [*lost, *(out / "film").glob("*.json"), *(out / "film").glob("*.mp4")]:
        path.unlink()
    return kept, kept.stat().st_mtime_ns


def codes(folder):
    return np.stack([read_encoded(view).astype(int) for view in read_capture(folder).views])


def files(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def assert_close(folder, expected, atol, but=("header",)):
    """Two scenes with the same parameters, but for some of them."""
    with np.load(folder / "scene.npz") as found, np.load(expected / "scene.npz") as known:
        assert found.files == known.files
        for name in set(found.files) - {*but}:
            np.testing.assert_allclose(found[name], known[name], atol=atol, err_msg=name)


def assert_like(out, one):
    """Everything that was done, as one device has done it."""
    for done in ("scene", "film", "scores"):
        assert files(out / done) == files(one / done)
    assert np.abs(codes(out / "film") - codes(one / "film")).max() <= CODE
    ours, theirs = (json.loads((x / "scores/report.json").read_text()) for x in (out, one))
    for effect, row in theirs["effects"].items():
        assert ours["effects"][effect]["psnr"] == pytest.approx(row["psnr"], abs=DECIBEL)
    assert_close(out / "broken", one / "scene", SAME)
    assert_close(out / "scene", one / "scene", NEAR, FREE)
    for run in ("scene", "broken"):
        lines = (out / run / "metrics.jsonl").read_text().splitlines()
        assert [json.loads(line)["stage"] for line in lines] == ["coarse", "fine"]
    assert not (out / "broken" / "checkpoint.npz").exists()


@pytest.fixture(scope="module")
def two(truth, one, tmp_path_factory):
    """What two devices of one host do, and make of what one has begun."""
    out = tmp_path_factory.mktemp("two")
    begun(one, out)
    verbs = "resume,reconstruct,render,evaluate"
    code, said = ended(started(truth, out, verbs, "devices.count=2"))
    assert code == [0], said
    return out


@pytest.mark.slow
def test_two_devices_do_what_one_does(one, two):
    assert_like(two, one)


@pytest.mark.slow
def test_two_hosts_do_what_one_does_and_go_on_with_what_it_began(truth, one, two, tmp_path):
    kept, written = begun(one, tmp_path)
    code, said = two_hosts(truth, tmp_path, "resume,reconstruct,render,evaluate")
    assert code == [0, 0], said
    assert_like(tmp_path, one)
    # Two numbers have one sum, wherever they are.
    assert_close(tmp_path / "scene", two / "scene", 0)
    assert kept.stat().st_mtime_ns == written
    # What is found is said once.
    assert "film: 3 frames" in said[0][0] and "frames" not in said[1][0]


@pytest.mark.slow
def test_a_host_that_fails_ends_the_others(truth, tmp_path):
    code, said = two_hosts(truth, tmp_path, "render", "scene=none")
    assert code[1] == 2 and "none: no such file" in said[1][1]
    assert code[0] != 0


def test_a_process_alone_leads_and_takes_its_share_of_everything():
    assert is_primary() and items_of_this_process([1, 2, 3]) == [1, 2, 3]
    tree = {"a": np.arange(3)}
    assert from_primary(tree) is tree
    assert mesh_of_hosts(1) == mesh(1)
    placed = replicate(tree, mesh_of_hosts())
    assert placed["a"].sharding.is_fully_replicated
    assert replicate(placed, mesh_of_hosts())["a"] is placed["a"]


def test_more_devices_than_there_are_fail():
    found = jax.local_device_count()
    with pytest.raises(ValueError, match=f"devices.count must be at most {found}"):
        start_devices(DevicesOptions(count=found + 1))


def test_where_jax_is_at_work_no_hosts_can_be_met():
    hosts = DevicesOptions(hosts=2, process=0, coordinator="localhost:1")
    with pytest.raises(ValueError, match="devices.hosts must be 1 where JAX has already started"):
        start_devices(hosts)


@pytest.mark.ci
def test_without_a_cluster_hosts_must_be_named(tmp_path):
    code, said = ended(started(tmp_path, tmp_path, "render", "devices.hosts=0"))
    assert code == [2] and "devices.hosts must be 1 or more where no cluster says" in said[0][1]


def test_pictures_that_another_host_keeps_to_itself_are_missed(tmp_path, monkeypatch):
    monkeypatch.setattr(dataset_files, "_NETWORK_DELAY", 0.0)
    monkeypatch.setattr(dataset_files, "is_distributed", lambda: True)
    with pytest.raises(OSError, match="12 files .* Choose a folder that all hosts share"):
        dataset_files.require_files(tmp_path, toy.records())


def test_pictures_that_vanish_from_a_host_of_its_own_are_missed_at_once(tmp_path):
    with pytest.raises(OSError, match="12 of 12 files have gone .* The same command"):
        dataset_files.require_files(tmp_path, toy.records())
