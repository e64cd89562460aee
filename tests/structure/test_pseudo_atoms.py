"""Particles of programs that are not atoms are removed from residues and waters, and reported."""

import pytest
from fixtures.samples import load

import protochain as pc
from protochain.structure.molecule.repairs import Kind
from protochain.structure.write import as_text

LINES = [line for line in as_text(load("1l2y.pdb"), ".pdb").splitlines() if line.startswith("ATOM")]
CALLED = {
    "PyMOL": ("PS1", "PS12"), "CYANA": ("QB", "QQD", "QR"), "Rosetta": ("CEN", "NV", "V1"),
    "CHARMM": ("DN", "DCA", "DC", "LPA", "LP1"), "GROMACS": ("MN1", "MN2", "MCB1"),
}  # fmt: skip


def line_of(name, residue="LEU A   2", x=(-4.0, 4.0, -2.0), element=""):
    at = "".join(f"{value:8.3f}" for value in x)
    return f"ATOM      1 {name:^4} {residue}    {at}  1.00  0.00          {element:>2}"


@pytest.mark.parametrize("element", ["", "X", "D"])
@pytest.mark.parametrize("program", CALLED)
def test_pseudo_atoms_of_a_residue_are_removed_and_named(program, element, tmp_path):
    at = next(k for k, line in enumerate(LINES) if "LEU A   2" in line)
    path = tmp_path / "x.pdb"
    more = [line_of(name, element=element) for name in CALLED[program]]
    path.write_text("\n".join([*LINES[: at + 1], *more, *LINES[at + 1 :], "END", ""]))
    s = pc.load(path)
    assert s.n_atoms == load("1l2y.pdb").n_atoms
    assert (s.positions == pc.load(_plain(tmp_path)).positions).all()
    (repair,) = [repair for repair in s.repairs if repair.kind is Kind.VIRTUAL]
    assert repair.facts["atoms"] == CALLED[program] and repair.facts["residue"].number == "2"


def _plain(folder):
    (folder / "plain.pdb").write_text("\n".join([*LINES, "END", ""]))
    return folder / "plain.pdb"


@pytest.mark.parametrize("names", [("QQ", "C99"), ("D", "HXX1")])
def test_other_unknown_atoms_are_not_taken_for_pseudo_atoms(names, tmp_path):
    """A carbon of an unknown name is still refused, a deuterium still read as hydrogen."""
    at = next(k for k, line in enumerate(LINES) if "LEU A   2" in line)
    path = tmp_path / "x.pdb"
    path.write_text("\n".join([*LINES[: at + 1], line_of(names[1]), *LINES[at + 1 :], "END", ""]))
    if names[1] == "C99":
        with pytest.raises(pc.ProtochainError, match="C99"):
            pc.load(path)
    else:
        assert Kind.VIRTUAL not in [repair.kind for repair in pc.load(path).repairs]


@pytest.mark.parametrize(
    ("water", "names", "n_sites"),
    [
        ("T4P", ("O1", "H1", "H2", "M1"), 1), ("SOL", ("OW", "HW1", "HW2", "MW"), 1),
        ("WAT", ("O", "H1", "H2", "EPW"), 1), ("HOH", ("O", "H1", "H2", "LP1", "LP2"), 2),
        ("SWM", ("OH2", "DOH2", "OM", "H1", "H2"), 2),
    ],
)  # fmt: skip
def test_waters_of_four_and_five_sites_are_waters(water, names, n_sites, tmp_path):
    at = dict(zip(names, ((0.0, 0.0, 0.0),) * len(names), strict=True))
    hydrogens = iter([(0.957, 0.0, 0.0), (-0.24, 0.927, 0.0)])
    lines = []
    for name in at:
        x = (
            next(hydrogens)
            if name.startswith("H")
            else (0.1, 0.12, 0.0)
            if not name.startswith("O")
            else (0, 0, 0)
        )
        element = "O" if name in ("O", "O1", "OW", "OH2") else "H" if name.startswith("H") else ""
        place = tuple(a + b for a, b in zip(x, (-2.857, 8.551, 0.613), strict=True))
        lines.append(line_of(name, f"{water} W   1", place, element).replace("ATOM  ", "HETATM"))
    path = tmp_path / "x.pdb"
    path.write_text("\n".join([*LINES, "TER", *lines, "END", ""]))
    s = pc.load(path)
    assert dict(s.left_out) == {"waters": 1} and s.losses == ()
    for keep in ("water", "all"):
        s = pc.load(path, keep=keep)
        assert s.n_residues == 21 and s.losses == () and s.n_atoms == 307
        (repair,) = [repair for repair in s.repairs if repair.kind is Kind.SITES]
        assert repair.facts["count"] == n_sites
