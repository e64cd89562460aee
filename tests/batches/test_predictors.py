"""Folders as programs that predict or design write them, small, go through ``relax FOLDER`` as they are."""

import gzip
import json
import shlex

import gemmi
import mdtraj
import numpy as np
import pandas as pd
import pytest
from fixtures.command_line import refusal, run
from fixtures.samples import STRUCTURES

RING = 1.39 * np.exp(1j * np.arange(6) * np.pi / 3)


def model(b=80.0, ligand=""):
    """The miniprotein without hydrogens, phenol as a chain of its own beside it, and one value of pLDDT."""
    s = gemmi.read_structure(str(STRUCTURES / "1l2y.pdb"))
    del s[1:]
    s.remove_hydrogens()
    if ligand:
        far, chain, residue = (
            max((p.atom.pos for p in s[0].all()), key=lambda x: x.x),
            gemmi.Chain("B"),
            gemmi.Residue(),
        )
        residue.name, residue.seqid, residue.het_flag = ligand, gemmi.SeqId("1"), "H"
        for k, z in enumerate([*RING, RING[0] * 2.75 / 1.39]):
            atom = gemmi.Atom()
            atom.name, atom.element = (
                ("O1", gemmi.Element("O")) if k == 6 else (f"C{k + 1}", gemmi.Element("C"))
            )
            atom.pos = gemmi.Position(far.x + 4.9 + z.real, far.y + z.imag, far.z)
            residue.add_atom(atom)
        chain.add_residue(residue)
        s[0].add_chain(chain)
    for place in s[0].all():
        place.atom.b_iso = b
    s.setup_entities()
    s.entities[0].full_sequence = [residue.name for residue in s[0]["A"]]
    s.assign_label_seq_id(True)
    return s


def padded(s, unknown):
    """Backbones with C-beta, and nine virtual atoms upon it."""
    for residue in s[0]["A"]:
        for name in [a.name for a in residue if a.name not in ("N", "CA", "C", "O", "CB")]:
            residue.remove_atom(name, "*")
        if unknown:
            residue.name = "UNK"
        for k in range(9):
            atom = residue[-1].clone()
            atom.name, atom.element = f"V{k}", gemmi.Element("X")
            residue.add_atom(atom)
    return s


def bare(s):
    """Side chains at the origin."""
    for residue in s[0]["A"]:
        for atom in residue:
            if atom.name not in ("N", "CA", "C", "O"):
                atom.pos = gemmi.Position(0, 0, 0)
    return s


def written(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".npz":
        np.savez(path, **content)
    elif isinstance(content, gemmi.Structure):
        text = (
            content.make_pdb_string() if path.suffix == ".pdb" else content.make_mmcif_document().as_string()
        )
        path.write_bytes(gzip.compress(text.encode()) if path.suffix == ".gz" else text.encode())
    else:
        path.write_text(content if isinstance(content, str) else json.dumps(content))


PAIRS = {"iptm": 0.5, "chain_pair_iptm": [[0.9, 0.5], [0.5, 0.9]]}
FOLDERS = {
    "AlphaFold 3": {
        "job/job_model.cif": lambda: model(ligand="IPH"), "job/job_summary_confidences.json": PAIRS,
        "job/job_confidences.json": {"pae": [[1.0] * 27] * 27, "token_chain_ids": ["A"] * 20 + ["B"] * 7},
        "job/job_data.json": {}, "job/job_ranking_scores.csv": "seed,sample,ranking_score\n1,0,0.5\n",
        "job/seed-1_sample-0/job_seed-1_sample-0_model.cif": lambda: model(ligand="IPH"),
        "job/seed-1_sample-0/job_seed-1_sample-0_summary_confidences.json": PAIRS,
        "job/TERMS_OF_USE.md": "Terms",
    },
    "Boltz-2": {
        "boltz_results_x/predictions/x/x_model_0.cif": lambda: model(0.91, "LIG"),
        "boltz_results_x/predictions/x/confidence_x_model_0.json": {"iptm": 0.4},
        "boltz_results_x/predictions/x/affinity_x.json": {"affinity_pred_value": -1.0},
        "boltz_results_x/predictions/x/plddt_x_model_0.npz": {"plddt": np.ones(27)},
        "boltz_results_x/processed/structures/x.npz": {"atoms": np.zeros(3)},
        "boltz_results_x/processed/manifest.json": {},
    },
    "Chai-1": {
        "pred.model_idx_0.cif": lambda: model(ligand="LIG1"),
        "scores.model_idx_0.npz": {"iptm": np.ones(1), "per_chain_pair_iptm": np.ones((1, 2, 2))},
        "msa_depth.pdf": "%PDF",
    },
    "Protenix": {
        "job/seed_101/predictions/job_sample_0.cif": model,
        "job/seed_101/predictions/job_summary_confidence_sample_0.json": {"iptm": 0.0},
        "ERR/.keep": "",
    },
    "OpenFold 3": {
        "query_1/seed_42/query_1_seed_42_sample_1_model.cif": model, "query_1/seed_42/timing.json": {},
        "query_1/seed_42/query_1_seed_42_sample_1_confidences_aggregated.json": {"avg_plddt": 80.0},
        "query_1/seed_42/query_1_seed_42_sample_1_confidences.json": {"plddt": [80.0], "pde": [[1.0]]},
    },
    "RosettaFold 3": {
        "job/job_model.cif": model, "job/job_summary_confidences.json": {"iptm": None, "ptm": 0.5},
        "job/seed-0_sample-0/job_seed-0_sample-0_model.cif.gz": model, "job/job_ranking_scores.csv": "a,b\n",
    },
    "RFdiffusion3": {
        "spec_0_model_0.cif.gz": lambda: padded(model(0.0), False), "spec_0_model_0.json": {"metrics": {}},
        "spec_0_model_1.cif.gz": lambda: padded(model(0.0), True), "spec_0_model_1.json": {"metrics": {}},
    },
    "BoltzGen": {
        "intermediate_designs/design_0.cif": lambda: bare(model(0.0)),
        "intermediate_designs/design_0.npz": {"design_mask": np.ones(20)},
        "final_ranked_designs/final_1_designs/rank1_design_0.cif": model, "steps.yaml": "a: 1\n",
    },
    "BindCraft": {
        "Accepted/x_l20_s1_mpnn1_model1.pdb": lambda: model(0.87), "Accepted/Animation/x.html": "",
        "Accepted/Ranked/1_x_l20_s1_mpnn1_model1.pdb": lambda: model(0.87), "designs.csv": "Rank\n",
    },
    "ColabFold": {
        f"job/{name.format('job')}": content for name, content in {
            "{}_unrelaxed_rank_001_alphafold2_ptm_model_3_seed_000.pdb": model,
            "{}_relaxed_rank_001_alphafold2_ptm_model_3_seed_000.pdb": model,
            "{}_unrelaxed_rank_002_alphafold2_ptm_model_1_seed_000.pdb": model,
            "{}_scores_rank_001_alphafold2_ptm_model_3_seed_000.json": {"plddt": [80.0] * 20, "ptm": 0.5},
            "{}_scores_rank_002_alphafold2_ptm_model_1_seed_000.json": {"plddt": [80.0] * 20, "ptm": 0.4},
            "{}_predicted_aligned_error_v1.json": {"predicted_aligned_error": [[1.0]]},
            "{}.a3m": ">x\nAA\n", "{}.done.txt": "", "{}_pae.png": "", "config.json": {}, "log.txt": "",
            "cite.bibtex": "@article{}", "{}_env/pdb70.m8": "", "{}_template_domain_names.json": {},
        }.items()
    },
    "ESMFold2": {"x.cif": lambda: model(0.87), "x.pdb": lambda: model(0.87)},
}  # fmt: skip
REPORTED = {
    "Chai-1": ("B:LIG1 1 stays in place",),
    "RFdiffusion3": ("pseudo-atoms V0", "A:UNK20: read as ALA"),
    "BoltzGen": ("CB, CG, OD1, ND2 at the origin, upon CA or over 15 angstrom away: treated as missing",),
}


def make(folder, files):
    for name, content in files.items():
        written(folder / name, content() if callable(content) else content)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """All folders, relaxed by one command."""
    raw, out = tmp_path_factory.mktemp("raw"), tmp_path_factory.mktemp("made") / "out"
    for program, files in FOLDERS.items():
        make(raw / program, files)
    assert run("relax", raw, "-o", out, "--workers", "1") == 0
    return out, pd.read_csv(out / "relaxed.csv")


@pytest.mark.parametrize("program", FOLDERS)
def test_a_folder_of_a_program_goes_through(done, program):
    (out, table), files = done, FOLDERS[program]
    table = table[table["structure"].str.startswith(f"{program}/")]
    assert {*table["status"]} == {"converged"}
    assert len(table) == sum(callable(content) for content in files.values())
    repairs = "; ".join(table["repairs"])
    assert all(each in repairs for each in REPORTED.get(program, ()))
    for name, content in files.items():
        if not callable(content):
            goes_along = name.rpartition("/")[2].startswith(("scores.", "affinity_", "plddt_"))
            goes_along |= name.endswith(".json") and ("confidence" in name or "_scores_rank_" in name)
            assert (out / program / name).exists() is goes_along


def test_a_ligand_without_a_name_of_its_own_gets_its_chemistry(tmp_path):
    make(tmp_path, FOLDERS["Chai-1"])
    out = tmp_path / "out"
    assert run("relax", tmp_path, "-o", out, "--workers", "1", "--ligands", "LIG1=Oc1ccccc1") == 0
    assert "B:LIG1 1 moves" in pd.read_csv(out / "relaxed.csv")["repairs"][0]


def test_frames_in_a_folder_of_bioemu_are_named_with_what_relaxes_them(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    written(tmp_path / "raw" / "topology.pdb", model())
    x = mdtraj.load("raw/topology.pdb", no_boxchk=True)
    x.unitcell_vectors = None
    x.save_xtc("raw/samples.xtc")
    assert run("relax", "raw", "-o", "out", "--workers", "1") == 0
    (line,) = (each for each in capsys.readouterr().err.splitlines() if "samples.xtc" in each)
    assert run(*shlex.split(line.partition("protochain ")[2]), "--workers", "1") == 0
    made = mdtraj.load("samples.relaxed.xtc", top="samples.relaxed.pdb")
    alpha = made.topology.select("name CA")
    near = 10.0 * np.abs(made.xyz[0, alpha] - x.xyz[0, x.topology.select("name CA")])
    assert len(made) == 1 and near.max() < 1.0


@pytest.mark.parametrize("sequence", [{}, {"sequence": "NLYIQWLKDGGPSSGRPPPS"}, {"sequence": "A" * 20}])
def test_samples_of_bioemu_have_a_sequence_or_not(tmp_path, sequence):
    s = model()
    at = {name: np.array([r[name][0].pos.tolist() for r in s[0]["A"]]) / 10 for name in ("N", "CA", "C")}
    along = at["C"] - at["CA"]
    along /= np.linalg.norm(along, axis=1)[:, None]
    across = at["N"] - at["CA"]
    across -= np.sum(across * along, axis=1)[:, None] * along
    across /= np.linalg.norm(across, axis=1)[:, None]
    turn = np.stack([along, across, np.cross(along, across)], axis=2)
    batch, topology = tmp_path / "batch_0000000_0000002.npz", tmp_path / "topology.pdb"
    np.savez(batch, pos=[at["CA"]] * 2, node_orientations=[turn] * 2, **sequence)
    written(topology, bare(s))
    command = ("relax", topology, "--trajectory", batch, "-o", tmp_path / "r.xtc", "--workers", "1")
    if sequence == {"sequence": "A" * 20}:
        assert "give the topology of the frames" in refusal(*command)
        return
    assert run(*command) == 0
    made = mdtraj.load(tmp_path / "r.xtc", top=tmp_path / "r.pdb")
    alpha = made.xyz[:, made.topology.select("name CA")]
    assert len(made) == 2
    assert np.abs(alpha - alpha.mean(1)[:, None] - (at["CA"] - at["CA"].mean(0))).max() < 0.05


@pytest.mark.parametrize("n", [3, pytest.param(100, marks=pytest.mark.slow)])
def test_each_record_of_a_docking_program_is_a_row_with_its_own_pose(tmp_path, monkeypatch, n):
    """GNINA, Vina and DiffDock write one file of many records: here methanol at places on a spiral."""
    monkeypatch.chdir(tmp_path)
    chem = pytest.importorskip("rdkit.Chem.AllChem")
    pytest.importorskip("dimorphite_dl")
    protein = mdtraj.load(STRUCTURES / "ala10.pdb").xyz[0] * 10.0
    methanol = chem.AddHs(chem.MolFromSmiles("CO"))
    chem.EmbedMolecule(methanol, randomSeed=1)
    own = methanol.GetConformer().GetPositions()
    out = np.abs(protein - protein.mean(0)).max() + 5.0
    turns = np.arange(n) * 2.4
    places = protein.mean(0) + np.stack([out * np.cos(turns), out * np.sin(turns), 0.5 * turns], axis=1)
    with chem.SDWriter("poses.sdf") as writer:
        for place in places:
            methanol.GetConformer().SetPositions(own - own[0] + place)
            writer.write(methanol)
    asked = (
        "--ligands", "poses.sdf", "--ligand-charges", "gasteiger", "--solvent", "vacuum", "--workers", "1",
    )  # fmt: skip
    assert run("relax", STRUCTURES / "ala10.pdb", *asked, "-o", "out", "--ligand-out", "out.sdf") == 0
    table = pd.read_csv("out/relaxed.csv")
    assert table["structure"].tolist() == [f"ala10.poses_{k}" for k in range(1, n + 1)]
    assert {*table["status"]} == {"converged"}
    ends = np.array([each.GetConformer().GetPositions()[0] for each in chem.SDMolSupplier("out.sdf")])
    assert np.linalg.norm(ends[:, None] - places, axis=2).argmin(1).tolist() == [*range(n)]
