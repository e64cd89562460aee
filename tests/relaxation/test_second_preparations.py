"""Settings of a structure hold when it is prepared again: for mutants, sequences, and rebuilt side chains."""

import re
from functools import cache

import numpy as np
import pytest
from fixtures.samples import STRUCTURES

import protochain as pc

INSULIN, POSE = STRUCTURES / "3i40.pdb", str(STRUCTURES / "1N2J_PAF.sdf")
SEQUENCE = "B=FANQHLCGSHLVEALYLVCGERGFFYTPKV"
FEW = {"max_iterations": 1, "max_outer_iterations": 1, "threads": 1, "solvent": "vacuum"}
SITE = "segid B and resid 2"
COMMANDS = {
    "sequence": lambda more: [pc.relax(INSULIN, sequence=SEQUENCE, **FEW, **more)],
    "rebuild": lambda more: [pc.relax(INSULIN, rebuild_side_chains=SITE, **FEW, **more)],
    "repack": lambda more: [pc.relax(INSULIN, repack_region=SITE, **FEW, **more)],
    "mutate": lambda more: [(m := pc.mutate(INSULIN, "B:V2A", **FEW, **more)).wild, m.mutant],
    "to itself": lambda more: [pc.mutate(INSULIN, "B:V2V", **FEW, **more).mutant],
}


def acids(s):
    names = s.residue_name[s.atom_residue]
    return int(np.sum((names == "GLU") & (s.atom_name == "HE2")))


def parameters(s):
    """Of ligands, without the numbers of their atoms."""
    return [re.sub(r"\(\[[\d, ]+\], ", "", ligand.in_energy()) for ligand in s.ligands]


PROPERTIES = {
    "disulfide": lambda s: int((s.atom_name[s.bonds] == "SG").all(axis=1).sum()),
    "ph": acids,
    "chains": lambda s: sorted({*s.residue_chain.tolist()}),
    "cap": lambda s: [name for name in s.residue_name.tolist() if name in ("ACE", "NME")],
    "ligand_charges": parameters,
    "keep": lambda s: int(np.sum(s.residue_name == "HOH")),
}
SETTINGS = {
    "all chains": {
        "disulfide": ("none", "A:6-A:11"), "ph": 2.0, "cap": "all", "keep": ("water",),
        "ligands": (("", POSE),), "ligand_charges": "gasteiger", "forcefield": "amber99sb",
        "restraints": "distance B:9:CA B:13:CA 0 4 100", "exclude": "segid B and resid 9",
    },
    "one chain": {"chains": ("B",)},
}  # fmt: skip


@cache
def once(kind):
    """The structure of the settings, prepared once, and of all defaults."""
    settings = {
        name: value for name, value in SETTINGS[kind].items() if name not in ("restraints", "exclude")
    }
    return pc.Setup(**settings).load(INSULIN), pc.load(INSULIN)


@pytest.mark.parametrize("kind", SETTINGS)
@pytest.mark.parametrize("command", COMMANDS)
def test_settings_hold_in_a_second_preparation(command, kind):
    first, usual = once(kind)
    for done in COMMANDS[command](SETTINGS[kind]):
        assert done.energy_function.forcefield == SETTINGS[kind].get("forcefield", "amber14")
        assert len(done.restraint_values) == ("restraints" in SETTINGS[kind])
        for name in PROPERTIES.keys() & SETTINGS[kind].keys():
            has = PROPERTIES[name]
            assert has(done.structure) == has(first) != has(usual), name
