"""Ramachandran, omega, C-beta, rotamers and hands against cctbx, and on structures changed by hand."""

import csv
from collections import defaultdict

import numpy as np
import pytest
from fixtures.molecules import atom, shaken, turned
from fixtures.samples import ROOT, chain, load, shared
from scipy.spatial.transform import Rotation

import protochain as pc
from protochain.validation.cbeta import LIMIT, cbeta_deviations
from protochain.validation.findings import Findings, describe_remains, remains
from protochain.validation.layout import dihedrals, layout
from protochain.validation.omega import omegas
from protochain.validation.ramachandran import CLASSES, REGIONS, ramachandran, score, tables
from protochain.validation.rotamers import rotamers, side_chains

DEGREES, ANGSTROM, SCORE = 2e-3, 2e-4, 2e-6
"""Of cctbx's values, from the same coordinates: rounded to the digits of the frozen table, scores of up to 1
in single precision."""

with (ROOT / "tests" / "fixtures" / "cctbx.csv").open(newline="") as file:
    FROZEN = list(csv.DictReader(file))
"""ramalyze, cbetadev and omegalyze of cctbx-base 2025.11 on samples without alternate locations."""


def place(s, r):
    return str(s.residue_chain[r]).strip(), f"{s.residue_number[r]}{s.residue_insertion_code[r]}"


def ours(s):
    """What is found of each residue, by chain and number."""
    rows = defaultdict(dict)
    rama, bonds, beta = ramachandran(s), omegas(s), cbeta_deviations(s)
    for r, phi, psi, kind, value, region in zip(*rama, strict=True):
        rows[place(s, r)] |= {
            "kind": CLASSES[kind], "phi": phi, "psi": psi, "score": value, "region": REGIONS[region],
        }  # fmt: skip
    for r, off in zip(*beta, strict=True):
        rows[place(s, r)]["cbeta"] = off
    for r, omega, _, cis, twisted in zip(*bonds, strict=True):
        rows[place(s, r)] |= {"omega": omega, "peptide": "cis" if cis else "twisted" if twisted else "trans"}
    return rows


def apart(a, b):
    return abs((a - b + 180.0) % 360.0 - 180.0)


@pytest.mark.parametrize("name", sorted({row["file"] for row in FROZEN}))
def test_every_residue_of_the_samples_is_as_cctbx_has_it(name):
    found = ours(load(name))
    rows = [row for row in FROZEN if row["file"] == name]
    assert found.keys() == {(row["chain"], row["residue"]) for row in rows}
    for row in rows:
        own = found[row["chain"], row["residue"]]
        there = {key for key in ("kind", "phi", "psi", "score", "region", "cbeta", "omega") if row[key]}
        assert own.keys() - {"peptide"} == there, row
        for key in there & {"kind", "region"}:
            assert own[key] == row[key], row
        for key in there & {"phi", "psi", "omega"}:
            assert apart(own[key], float(row[key])) < DEGREES, row
        for key, limit in (("score", SCORE), ("cbeta", ANGSTROM)):
            if key in there:
                assert own[key] == pytest.approx(float(row[key]), abs=limit), row


COUNTS = {
    "1ake_A.pdb": (212, 0, 207, 194, 2, 1, 0, 0),
    "af_with_violations.pdb": (146, 18, 111, 138, 0, 0, 0, 7),
    "1orc_icode.pdb": (62, 0, 61, 59, 1, 1, 0, 0),
}
"""Of cctbx-base 2025.11: residues on the Ramachandran plot, outliers, favoured; C-betas, outliers; cis
prolines, other cis peptides, twisted peptides."""


@pytest.mark.parametrize("name", COUNTS)
def test_counts_are_those_of_cctbx(name):
    s = pc.load(shared(name), keep="none")
    rama, bonds, beta = ramachandran(s), omegas(s), cbeta_deviations(s)
    seen = ~s.built[layout(s).atoms("CB")[beta.residue, 0]]
    assert (
        len(rama.residue), len(rama.outliers), int((rama.region == 2).sum()), int(seen.sum()),
        int((beta.deviation[seen] >= LIMIT).sum()), int((bonds.cis & bonds.proline).sum()),
        int((bonds.cis & ~bonds.proline).sum()), int(bonds.twisted.sum()),
    ) == COUNTS[name]  # fmt: skip


def test_tables_are_percentiles_whose_regions_lie_where_they_should():
    assert tables().shape == (6, 180, 180) and tables().min() == 0.0 and tables().max() == 1.0
    helix, strand, left = (-60.0, -45.0), (-120.0, 130.0), (57.0, 45.0)
    most, glycine = CLASSES.index("general"), CLASSES.index("glycine")

    def at(kind, *places):
        phi, psi = np.array(places).T
        return score(np.full(len(places), kind), phi, psi)

    assert (at(most, helix, strand, left) > 0.02).all() and at(most, (60.0, -90.0))[0] < 0.0005
    # Glycine has no hand, its table is symmetric, also across the edge.
    places = [helix, strand, (179.5, 170.0), (80.0, -0.3), (-179.99, -179.99)]
    assert at(glycine, *places) == pytest.approx(
        at(glycine, *[(-phi, -psi) for phi, psi in places]), rel=1e-4
    )
    # At a point of the table its value, half way between two their mean, and periodic.
    assert at(most, (-59.0, -45.0))[0] == tables()[most, 60, 67]
    assert at(most, (-58.0, -45.0))[0] == pytest.approx(tables()[most, 60:62, 67].mean())
    assert at(most, (-59.0, -44.0))[0] == pytest.approx(tables()[most, 60, 67:69].mean())
    assert (
        at(most, (180.0, 160.0))[0]
        == at(most, (-180.0, 160.0))[0]
        == pytest.approx(tables()[most][[179, 179, 0, 0], [169, 170, 169, 170]].mean())
    )


def test_classes_go_by_what_a_residue_is_and_precedes():
    s = pc.from_sequence("AGPVPIAVGP" + "A")
    found = ramachandran(s)
    assert [CLASSES[k] for k in found.kind] == [
        "glycine", "trans_proline", "pre_proline", "trans_proline", "ile_val", "general", "ile_val",
        "glycine", "trans_proline",
    ]  # fmt: skip
    assert found.residue.tolist() == list(range(1, 10))


def test_peptide_bonds_turned_by_hand_are_cis_or_twisted():
    s = pc.from_sequence("AAPAA")
    assert not omegas(s).cis.any() and not omegas(s).twisted.any()
    for residue in (1, 2):
        axis = atom(s, residue - 1, "C"), atom(s, residue, "N")
        for by, cis, twisted in (
            (20, 0, 0),
            (-29, 0, 0),
            (31, 0, 1),
            (85, 0, 1),
            (95.5, 0, 1),
            (-149, 0, 1),
            (151, 1, 0),
            (180, 1, 0),
        ):
            x = turned(s, residue, axis, by)
            found = omegas(s, x)
            assert (found.cis.sum(), found.twisted.sum()) == (cis, twisted), (residue, by)
            assert found.residue.tolist() == [1, 2, 3, 4] and found.proline.tolist() == [0, 1, 0, 0]
            if cis or twisted:
                assert found.residue[found.cis | found.twisted].tolist() == [residue]
            counts = Findings(s, x).measures()
            assert (counts["cis_peptides"], counts["cis_prolines"]) == (
                cis * (residue == 1),
                cis * (residue == 2),
            )
            # A proline beyond 90 degrees counts as cis on the Ramachandran plot.
            kind = CLASSES[ramachandran(s, x).kind[1]]
            assert kind == ("cis_proline" if residue == 2 and abs(by) > 95 else "trans_proline")


def test_a_chain_that_ends_or_breaks_has_no_dihedral_there_and_a_ring_closes():
    insulin = load("3i40.pdb")
    ends = [
        r for r in range(1, insulin.n_residues) if insulin.residue_chain[r] != insulin.residue_chain[r - 1]
    ]
    found = ramachandran(insulin).residue.tolist()
    assert ends and not {0, *ends, *(r - 1 for r in ends), insulin.n_residues - 1} & set(found)
    assert not set(ends) & set(omegas(insulin).residue.tolist())
    cyclic = pc.load(shared("5vav_cyclic.pdb"))
    assert len(ramachandran(cyclic).residue) == len(omegas(cyclic).residue) == 14
    capped = pc.load(shared("aaqaa3_capped.pdb"))
    # Caps are no amino acids: cctbx does not look at the residues beside them either.
    assert len(layout(capped).amino) == 16 and layout(capped).amino.sum() == 14
    assert ramachandran(capped).residue.tolist() == list(range(2, 14)) and len(omegas(capped).residue) == 13


def test_a_mirror_image_is_wrong_in_hand_and_c_beta_unless_it_is_named_so(tmp_path):
    s = load("1l2y.pdb")
    own = Findings(s, s.positions).measures()
    assert own["inverted_stereocentres"] == 0
    mirrored = Findings(s, s.positions * [1.0, 1.0, -1.0])
    # Every residue but three glycines; isoleucine also at C-beta.
    assert mirrored.measures()["inverted_stereocentres"] == 17 + 1
    assert mirrored.measures()["cbeta_outliers"] == 17 and mirrored.cbeta.deviation.min() > 1.5
    named = {"LEU": "DLE", "TYR": "DTY", "ILE": "DIL", "GLN": "DGN", "TRP": "DTR", "LYS": "DLY", "ASP": "DAS",
             "SER": "DSN", "PRO": "DPR", "ARG": "DAR", "ASN": "DSG", "GLY": "GLY"}  # fmt: skip
    pc.save(s.with_positions(mirrored.x), tmp_path / "d.pdb")
    lines = (tmp_path / "d.pdb").read_text().splitlines()
    text = "\n".join(
        line[:17] + named[line[17:20]] + line[20:] if line.startswith("ATOM") else line
        for line in lines
        if not line.startswith(("SEQRES", "HELIX", "SHEET"))
    )
    (tmp_path / "d.pdb").write_text(text)
    d = pc.load(tmp_path / "d.pdb")
    assert d.mirrored.sum() == 17 and d.residue_name.tolist() == s.residue_name.tolist()
    again = Findings(d, d.positions)
    # Only glycine, which has no name for its mirror image, is where its table does not know.
    kept = s.residue_name[again.ramachandran.residue] != "GLY"
    assert again.ramachandran.score[kept] == pytest.approx(ramachandran(s).score[kept], abs=1e-2)
    counts = again.measures()
    for key in ("inverted_stereocentres", "cbeta_outliers", "rotamer_outliers", "twisted_peptides"):
        assert counts[key] == own[key], key
    assert again.cbeta.deviation == pytest.approx(cbeta_deviations(s).deviation, abs=5e-3)


def test_c_beta_off_its_place_by_a_known_way():
    s = pc.from_sequence("AVPSG")
    found = cbeta_deviations(s)
    assert found.residue.tolist() == [0, 1, 2, 3] and found.deviation.max() < 0.15
    beta = atom(s, 1, "CB")
    x = s.positions.copy()
    for size in (0.02, 0.1):
        x[beta] = s.positions[beta] + [0.0, size, 0.0]
        off = cbeta_deviations(s, x).deviation
        assert abs(off[1] - 10.0 * size) <= found.deviation[1] and off[[0, 2, 3]] == pytest.approx(
            found.deviation[[0, 2, 3]]
        )
        assert cbeta_deviations(s, x).outliers.tolist() == ([1] if size > 0.05 else [])
    # As it turns with the molecule, so does its ideal place.
    turn = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix()
    assert cbeta_deviations(s, x @ turn.T + 1.0).deviation == pytest.approx(off, abs=1e-9)
    # Of atoms at one point it is the length of the bond.
    assert cbeta_deviations(s, np.zeros_like(x)).deviation == pytest.approx([1.536, 1.54, 1.53, 1.53])


def test_side_chains_on_a_rotamer_are_none_of_the_outliers_and_half_way_between_two_are():
    c = chain("1ubq.pdb")
    s = c.structure
    assert len(side_chains(s).residue) == 76 - 6 - 2 - 3  # but Gly, Ala, Pro
    hinges = {(h.kind, str(h.residue_number)): k for k, h in enumerate(c.hinges)}

    def bent(number, **chi):
        q = c.q0.copy()
        for kind, value in chi.items():
            q[c.tree.q_start[c.hinge_body[hinges[kind, number]]]] = np.radians(value)
        found = side_chains(s, pc.pose(c, q).x)
        (k,) = np.flatnonzero(s.residue_number[found.residue] == number)
        return str(found.rotamer[k]), found.distance[k] > 1.0

    assert bent("5", chi1=175.70) == ("t", False) and bent("5", chi1=120.0)[1]  # Val
    assert bent("5", chi1=175.7 - 25.5) == ("t", False) and bent("5", chi1=175.7 - 26.5)[1]
    assert (
        bent("15", chi1=-65.8, chi2=174.4) == ("mt", False) and bent("15", chi1=-65.8, chi2=120.0)[1]
    )  # Leu
    # Phe: its ring turned by half is the same ring.
    assert bent("45", chi1=-66.8, chi2=-80.6) == bent("45", chi1=-66.8, chi2=99.4) == ("m-80", False)
    assert bent("4", chi1=120.0, chi2=-80.6)[1]
    names, usual = rotamers()["LYS"]
    assert usual.shape == (len(names), 4) and dict(zip(names, usual[:, 0], strict=True))["mttt"] == -67.65


def test_a_dihedral_has_the_sign_of_iupac_and_none_without_its_atoms():
    x = np.array([[1.0, 0, 0], [0, 0, 0], [0, 0, 1.0], [0.5, 0.5, 1.0], [0.5, -0.5, 1.0], [-1.0, 0, 1.0]])
    atoms = np.array([[0, 1, 2, 3], [0, 1, 2, 4], [0, 1, 2, 5], [3, 2, 1, 0], [-1, 1, 2, 3]])
    found = dihedrals(x, atoms)
    # Seen from the second to the third atom, counterclockwise here is clockwise from the other side: -45.
    assert np.abs(found[:4]) == pytest.approx([45.0, 45.0, 180.0, 45.0]) and np.isnan(found[4])
    assert found[0] == -found[1] == found[3]
    import mdtraj

    frame = mdtraj.Trajectory(x[None].astype(np.float32), None)
    assert found[:2] == pytest.approx(np.degrees(mdtraj.compute_dihedrals(frame, atoms[:2])[0]), abs=1e-3)


def test_ramachandran_outliers_are_named_by_residue():
    s = shaken(load("1ubq.pdb"), 0.04)
    table = pc.validate(s).residues
    outliers = table[table.ramachandran == "outlier"]
    named = [f"{row.chain}:{row['name']}{row.residue}" for _, row in outliers.iterrows()]
    found = remains(s, s.positions)
    assert len(named) > 2 and found["ramachandran_outlier_residues"] == named
    assert f"Ramachandran outliers: {named[0]}, {named[1]}" in "".join(describe_remains(found))


def test_outliers_and_clashes_between_chains_are_named_by_residue():
    """Of insulin with chain B pushed into A; the table of residues is another way to the same."""
    s = load("3i40.pdb")
    x = s.positions.copy()
    is_b = (s.residue_chain == "B")[s.atom_residue]
    x[is_b] += (
        0.15 * (x[~is_b].mean(0) - x[is_b].mean(0)) / np.linalg.norm(x[~is_b].mean(0) - x[is_b].mean(0))
    )
    found, table = remains(s, x), pc.validate(s.with_positions(x)).residues
    named = table.apply(lambda row: f"{row.chain}:{row['name']}{row.residue}", axis=1)
    assert found["rotamer_outlier_residues"] == named[table.rotamer_outlier].tolist()
    assert found["ramachandran_outlier_residues"] == named[table.ramachandran == "outlier"].tolist()
    assert found["cbeta_outlier_residues"] == named[table.cbeta_deviation_angstrom >= 0.25].tolist()
    # Heavy atoms that are 2.4 angstrom apart and not bonded clash, whatever else does.
    heavy = np.flatnonzero(s.atom_element != "H")
    bonded = {frozenset(pair) for pair in s.bonds.tolist()}
    near = [
        (i, j)
        for i in heavy[~is_b[heavy]].tolist()
        for j in heavy[is_b[heavy]].tolist()
        if np.linalg.norm(x[i] - x[j]) < 0.2 and frozenset((i, j)) not in bonded
    ]
    pairs = {
        f"{s.describe_residue(int(s.atom_residue[i]))} with {s.describe_residue(int(s.atom_residue[j]))}"
        for i, j in near
    }
    assert pairs and pairs <= {*found["clashes_between_chains"]}
    assert all("A:" in each and "B:" in each for each in found["clashes_between_chains"])
