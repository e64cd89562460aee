"""What the values under a name are, in every record and table: the dictionary behind their schemas."""

from collections.abc import Iterable, Mapping
from typing import Any

from protochain.results.columns import UNITS

Kind = Any
"""``str``, ``float | None``, ``list[str]``, ``dict[str, int]``, an enumeration, a dataclass, a TypedDict;
name -> kind, an object that has these names and no others; ``[kind]``, a list of these."""

_KINDS: Mapping[str, Kind] = {
    name: kind
    for kind, names in (
        (str, """
            structure method status message file input output reference interface key protochain python judge
            frame engine engine_reason forcefield solvent hinges root move preset protocol
            bonds_to_hydrogen tolerance_unit exclude hydrogens repack_region chain residue name chain_1
            residue_1 name_1 chain_2 residue_2 name_2 of
            ramachandran_class ramachandran peptide_bond rotamer secondary_structure
            rotamer_before rotamer_after kind change first second pucker paired_with source matched_by
            chain_mapping added cost quantity held_by system_sha256 other setting outcome detail what verdict
            conformer table title scene error_of ligands_written report
            """),
        (int, """
            iteration iterations evaluations start seed max_iterations max_outer_iterations overlaps
            overlaps_start overlaps_end overlaps_beside_start overlaps_beside_end hydrogen_bonds salt_bridges
            matched_residues aligned_atoms measured_atoms heavy_atoms_added atoms_added wrong_hands
            bond_outliers angle_outliers threaded_rings clashes contacts domain rotamers_changed rigid_domains
            hydrogen_bonds_kept hydrogen_bonds_gained hydrogen_bonds_lost salt_bridges_kept
            salt_bridges_gained salt_bridges_lost runs converged mode products side unsatisfied_polar_atoms
            step steps every_steps freedoms output_frame residues_1 residues_2 n_q n_v
            minimum cluster walker evaluations_of_walker
            """),
        (int | None, "threads model round_trips"),
        (float | None, """
            seconds seconds_preparation tolerance coverage identity tm_score lddt contacts_kept phi psi omega
            chi1 chi2 chi3 chi4 frequency_per_cm eigenvalue_per_ps2 collectivity residual overlap
            cumulative_overlap lowest_frequency_per_cm b_factor_correlation largest_residual log_det_mass
            log_det_hessian entropy_kj_mol_k entropy_classical_kj_mol_k ramachandran_percent
            secondary_structure_kept tm_score_to_start reference_tm_score reference_coverage at median
            first_quartile third_quartile highest evaluations_median seconds_median value oracle error bound
            ratio difference total ns_per_day conserved_drift_kj_mol_ps_per_100_atoms friction_per_ps
            acceptance helix_share helix_share_error exchanges slope slope_error share share_error
            """),
        (bool, """
            free_ligands repacked violation rotamer_outlier pucker_outlier repeats_exactly is_minimum
            interrupted
            """),
        (list[str], """
            lost_atoms far_molecules repairs side_chains_turned hands_turned peptides_turned confidences
            not_written command findings loops inverted inverted_stereocentres d_amino_acids_unnamed
            inverted_double_bonds clashes_between_chains rotamer_outlier_residues cbeta_outlier_residues
            fixed_residues
            """),
        (dict[str, int], "left_out constant_terms fixed"),
        (dict[str, str], "versions"),
        (list[float | str], "restraint_kj_mol_nm2"),
        (list[float], "temperatures_k springs_backbone_kj_mol_nm2 springs_side_chains_kj_mol_nm2"),
        (bool | None, "posebusters_passed"),
        (list[str] | None, "posebusters_failed"),
    )
    for name in names.split()
}  # fmt: skip
"""Kinds of names without a unit, and of those whose values are not one number."""


def kind_of(name: str) -> Kind:
    """Kind of values under a name: what has a unit is a number or null, what begins with ``n_`` counts."""
    if name in _KINDS:
        return _KINDS[name]
    if any(name.endswith(unit) for unit in UNITS):
        return float | None
    return int if name.startswith("n_") else _KINDS[name]


def row(names: Iterable[str], known: Mapping[str, Kind] | None = None, **own: Kind) -> dict[str, Kind]:
    """Kinds of the values of a row with these names; ``known`` and ``own`` are those of some of them."""
    given = {**(known or {}), **own}
    return {name: given[name] if name in given else kind_of(name) for name in (*names, *own)}
