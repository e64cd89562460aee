"""Energies on OpenMM's platforms of GPUs: by OpenCL on the processor (pocl), if it is there, and by the CPU
platform in the place of CUDA, for OpenMM's minimiser ends the process on pocl.
"""

import pickle
import warnings
from types import SimpleNamespace

import numpy as np
import openmm
import pytest
from filelock import FileLock
from fixtures.samples import STRUCTURES, chain, energy, load
from fixtures.tolerances import DEVICE_END, DEVICE_ENERGY, DEVICE_FORCE

import protochain as pc
from protochain.batches.frame_tasks import RelaxFrames
from protochain.chains.setup import Setup
from protochain.core.errors import DeviceWarning
from protochain.energies import NativeEnergy, on_device
from protochain.energies.decomposed import native_of
from protochain.energies.on_device import DeviceEnergy, choose_device
from protochain.minimisers.recipes import RECIPES
from protochain.minimisers.restraints import Tethers
from protochain.relaxation.relax_settings import RelaxSettings

NAMES = {openmm.Platform.getPlatform(k).getName() for k in range(openmm.Platform.getNumPlatforms())}
BY_OPENCL = pytest.mark.skipif("OpenCL" not in NAMES, reason="OpenMM has no platform OpenCL here")
MINIMISE = openmm.LocalEnergyMinimizer.minimize
CAGE = "1l2y.pdb"


@pytest.fixture(autouse=True)
def locks(tmp_path, monkeypatch):
    monkeypatch.setattr(on_device, "LOCKS", tmp_path)
    return tmp_path


@pytest.fixture
def cuda(monkeypatch):
    """The CPU platform in the place of CUDA; calls of OpenMM's minimiser are counted."""
    monkeypatch.setitem(on_device.PLATFORMS, "cuda", "CPU")
    monkeypatch.setattr(DeviceEnergy, "_properties", {"Threads": "1"})  # Sums in one order.
    calls = []
    monkeypatch.setattr(
        openmm.LocalEnergyMinimizer, "minimize", lambda *args: calls.append(args) or MINIMISE(*args)
    )
    return calls


def fails(monkeypatch, message):
    def failing(*args):
        raise openmm.OpenMMException(message)

    monkeypatch.setattr(openmm.LocalEnergyMinimizer, "minimize", failing)


def rms(forces):
    return np.sqrt((forces**2).sum(axis=1).mean())


def of_complex():
    pose = str(STRUCTURES / "1P2Y_NCT.sdf")
    return pc.load(STRUCTURES / "5awl.pdb", ligands=(pose,), ligand_charges="gasteiger")


def test_auto_is_a_gpu_where_there_is_one_and_it_pays(monkeypatch):
    for there, n_atoms, fewest, device in (
        ({"opencl"}, 9000, 5000, "cpu"), (set(), 9000, 5000, "cpu"), ({"cuda", "opencl"}, 4999, 5000, "cpu"),
        ({"hip", "cuda"}, 5000, 5000, "cuda"), ({"hip"}, 5000, 5000, "hip"), ({"cuda"}, 1231, 1000, "cuda"),
    ):  # fmt: skip
        monkeypatch.setattr(on_device, "_loaded_devices", lambda there=there: there)
        assert choose_device("auto", n_atoms, fewest) == device
        assert (
            choose_device("opencl", 10, fewest) == "opencl" and choose_device("cpu", n_atoms, fewest) == "cpu"
        )


def test_an_energy_is_on_the_device_that_pays(cuda, monkeypatch):
    s = load(CAGE)
    assert isinstance(pc.energy(s), NativeEnergy)
    monkeypatch.setattr(on_device.choose_device, "__defaults__", (300,))
    made = pc.energy(s)
    assert (made.device, made.engine, made.exact.engine) == ("cuda", "openmm", "native")
    assert pc.energy(s, engine="native").device == "cpu" == pc.energy(s, device="cpu").device
    assert not RECIPES["lbfgs"].repeats_exactly(made)
    assert pc.energy(pc.minimise(s, made, max_evaluations=5), solvent="vacuum").device == "cuda"


@pytest.mark.parametrize(("device", "words"), [("cuda", "leave out device"), ("gpu", "choose from")])
def test_a_device_that_cannot_be_meant_is_refused(device, words):
    with pytest.raises(pc.ProtochainError, match=words):
        pc.energy(load("ala10.pdb"), engine="native", device=device)


def test_frames_share_a_context_and_take_a_gpu_sooner(cuda, monkeypatch):
    monkeypatch.setattr("protochain.core.defaults.DEVICE_FROM_IN_FRAMES", 300)
    made = []

    def energy(self, structure, build=None):
        made.append(self.device)
        raise InterruptedError

    monkeypatch.setattr(Setup, "energy", energy)
    for engine, device in (("auto", "cuda"), ("native", "cpu")):
        with pytest.raises(InterruptedError):
            RelaxFrames(RelaxSettings(), Setup(engine=engine)).begin(load(CAGE), 1)
        assert made.pop() == device


@BY_OPENCL
@pytest.mark.parametrize(
    ("structure", "settings"),
    [
        (lambda: load(CAGE), {}),
        (lambda: load("1bna.pdb"), {"solvent": "vacuum"}),
        pytest.param(of_complex, {}, marks=pytest.mark.slow),
        pytest.param(lambda: load(CAGE), {"solvent": "gbn2"}, marks=pytest.mark.slow),
        pytest.param(lambda: load(CAGE), {"forcefield": "charmm36"}, marks=pytest.mark.slow),
    ],
    ids=["protein", "DNA", "ligand", "gbn2", "charmm36"],
)
def test_forces_by_opencl_are_those_of_the_native_engine(structure, settings):
    s = structure()
    value, forces = pc.energy(s, **settings)(s.positions)
    found, near = pc.energy(s, device="opencl", **settings)(s.positions)
    assert found == pytest.approx(value, rel=DEVICE_ENERGY)
    assert 0.0 < rms(near - forces) < DEVICE_FORCE


@BY_OPENCL
def test_runs_by_opencl_end_as_those_on_the_processor():
    s, c = load(CAGE), chain(CAGE)
    e = pc.energy(s, device="opencl")
    for options in ({}, {"restraints": 1000.0}):
        here, there = (pc.minimise(c, each, **options) for each in (energy(CAGE), e))
        assert str(here.status) == str(there.status) == "converged"
        assert there.judge == here.judge and there.start.energy == here.start.energy
        assert there.end.rms_force <= there.tolerance
        assert np.sqrt(((here.x - there.x) ** 2).mean()) < DEVICE_END
        assert there.record()["device"] == "opencl" and "OpenCL" in there.record()["engine_reason"]
    fixed = pc.minimise(pc.build_chain(s, move="resid 5:9"), e)
    still = ~fixed.chain.moving
    assert fixed.status == "converged" and np.array_equal(fixed.x[still], s.positions[still])
    turned = pc.minimise(c, e, "lbfgs", tolerance=20.0)
    assert turned.status == "converged" and turned.end.max_torque <= 20.0


@BY_OPENCL
@pytest.mark.parametrize("structure", [lambda: load(CAGE), pytest.param(of_complex, marks=pytest.mark.slow)])
def test_relaxed_by_opencl_is_relaxed(structure):
    s = structure()
    here, there = (pc.relax(s, device=device) for device in ("cpu", "opencl"))
    assert there.status == here.status == "converged" and there.energy_start == here.energy_start
    assert there.energy_end == pytest.approx(here.energy_end, rel=1e-3)
    assert there.energy_function.device == "opencl" and there.judge == here.judge


def test_openmms_minimiser_begins_and_the_native_engine_ends(cuda):
    e = pc.energy(load(CAGE), device="cuda")
    for tolerance in (5.0, 1.0):
        r = pc.minimise(chain(CAGE), e, tolerance=tolerance)
        assert cuda and r.status == "converged" and r.end.rms_force <= tolerance
        assert r.end.energy == pytest.approx(energy(CAGE)(r.x)[0], rel=1e-9) and "native" in r.judge
        assert r.n_evaluations > 100 * len(cuda)
        cuda.clear()
    assert e(load(CAGE).positions)[0] == pytest.approx(energy(CAGE)(load(CAGE).positions)[0], rel=1e-6)
    few = pc.minimise(chain(CAGE), e, max_evaluations=120)
    assert few.status == "budget" and few.n_evaluations <= 120


def test_its_tethers_are_forces_of_openmm_while_it_runs(cuda):
    s = load(CAGE)
    e, moving = pc.energy(s, device="cuda"), np.ones(s.n_atoms, dtype=bool)
    tethers = Tethers.of_heavy_atoms(s, 1000.0)
    for springs in (tethers, None, tethers):
        x = e.descend(s.positions, moving, springs, 1.0, 2000)
        value, forces = energy(CAGE)(x)
        assert e(x)[0] == pytest.approx(value, rel=DEVICE_ENERGY)
        pull = tethers(x)[1] if springs else 0.0
        assert np.sqrt(((forces + pull) ** 2).mean()) < 2.0
        assert (rms(forces) > 10.0) == bool(springs)


def test_what_it_does_not_move_stays_bit_for_bit(cuda):
    s = load(CAGE)
    e = pc.energy(s, device="cuda")
    for move in ("resid 5:9", "sidechain"):
        r = pc.minimise(pc.build_chain(s, move=move), e)
        still = ~r.chain.moving
        assert r.status == "converged" and np.array_equal(r.x[still], s.positions[still])
    assert pc.minimise(chain(CAGE), e).ca_rmsd_angstrom > 0.1 and len(cuda) > 3


@pytest.mark.parametrize("options", [{"restraints": lambda x: (1.0, 0.0 * x)}, {"method": "lbfgs"}])
def test_it_does_not_begin_what_it_cannot_have(cuda, options):
    r = pc.minimise(chain(CAGE), pc.energy(load(CAGE), device="cuda"), tolerance=20.0, **options)
    assert r.status == "converged" and not cuda


def test_relax_begins_with_it(cuda):
    here, there = (pc.relax(load(CAGE), device=device) for device in ("cpu", "cuda"))
    assert cuda and there.status == here.status == "converged"
    assert there.energy_end == pytest.approx(here.energy_end, rel=1e-3)


@pytest.mark.parametrize("failure", ["driver", "memory", "lock"])
def test_without_a_device_the_run_is_the_processors_bit_for_bit(failure, locks, cuda, monkeypatch):
    s = load("ala10.pdb")
    here = pc.minimise(s), pc.relax(s)
    if failure == "driver":
        monkeypatch.setitem(on_device.PLATFORMS, "cuda", "nowhere")
    elif failure == "memory":

        def context(*args):
            raise openmm.OpenMMException("Error creating array posq: CUDA_ERROR_OUT_OF_MEMORY (2)")

        monkeypatch.setattr(openmm, "Context", context)
    else:
        # Not the one of this process, which it may take twice.
        monkeypatch.setattr(on_device, "_lock", lambda name, folder, process: FileLock(folder / name))
        lock = FileLock(locks / "cuda")
        lock.acquire()
    e = pc.energy(s, device="cuda")
    with pytest.warns(DeviceWarning) as told:
        there = pc.minimise(s, e), pc.relax(s, device="cuda")
        pc.minimise(s, e)
    reason = {"driver": "nowhere", "memory": "OUT_OF_MEMORY", "lock": "another process"}[failure]
    assert len(told) == 2 and all(reason in str(each.message) for each in told)
    for one, other in zip(here, there, strict=True):
        assert np.array_equal(one.x, other.x) and one.status == other.status
        assert (one.record()["device"], other.record()["device"]) == ("cpu", "cpu")
        assert reason in other.record()["engine_reason"]


@pytest.mark.parametrize(
    ("message", "n_warnings"), [("CUDA_ERROR_LAUNCH_FAILED (719)", 1), ("Energy or force is NaN.", 0)]
)
def test_a_kernel_that_fails_leaves_the_run_to_the_processor(message, n_warnings, cuda, monkeypatch):
    e = pc.energy(load(CAGE), device="cuda")
    fails(monkeypatch, message)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        r = pc.minimise(chain(CAGE), e)
    assert [each.category for each in told] == [DeviceWarning] * n_warnings
    assert r.status == "converged" and bool(e.failed) is bool(n_warnings)
    assert np.sqrt(((r.x - pc.minimise(chain(CAGE), energy(CAGE)).x) ** 2).mean()) < DEVICE_END


def test_an_evaluation_that_fails_is_the_processors(cuda):
    s = load(CAGE)
    e = pc.energy(s, device="cuda", accuracy=1e-3)
    e._current = (
        np.empty(0, np.int64),
        SimpleNamespace(setPositions=lambda x: openmm.Platform.getPlatform("?")),
    )
    with pytest.warns(DeviceWarning, match="no registered Platform"):
        value, forces = e(s.positions)
    assert e(s.positions)[0] == value and np.array_equal(forces, energy(CAGE)(s.positions)[1])
    assert "native kernels" in e.reason and "no registered Platform" in e.reason


def test_an_energy_on_a_device_is_taken_apart_and_pickled(cuda):
    s = load(CAGE)
    e = pc.energy(s, device="cuda")
    again = pickle.loads(pickle.dumps(e))
    assert again.device == "cuda" and again(s.positions)[0] == pytest.approx(e(s.positions)[0], rel=1e-6)
    assert isinstance(native_of(e), NativeEnergy)
    assert e.parts(s.positions)[0] == energy(CAGE).parts(s.positions)[0]
