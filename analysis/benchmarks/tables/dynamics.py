"""Constrained dynamics."""

import pandas as pd

from tables import SOLVENTS, digits_of, markdown, of_rows, paragraph, ratio_of, table, table_of_rows

MODELS = {
    "phi psi chi": "phi psi chi",
    "+ omega": "and omega",
    "+ rotors": "and rotors",
    "+ rotors, 4 amu hydrogens": "and rotors, hydrogens of 4 amu",
    "+ angles": "and bond angles at N and C-alpha",
    "all": "all of them",
}


@table("dynamics-energy", "dynamics_energy.csv")
def dynamics_energy(rows: pd.DataFrame) -> str:
    """Error, drift and cost by integrator and step."""
    return of_rows(
        rows[(rows["status"] == "completed") & (rows["step_fs"] >= 1)],
        ("integrator", "{integrator}"), ("step fs", "{step_fs:g}"), ("over ps", "{time_ps:g}"),
        ("error kJ/mol", "{error_kj_mol:.2g}"),
        ("drift kJ/mol/ps per 100 atoms", "{drift_kj_mol_ps_100_atoms:.0e}"),
        ("ms per step", digits_of("ms_per_step")),
    )  # fmt: skip


table_of_rows(
    "dynamics-steps", "dynamics_steps.csv",
    ("hinges", lambda r: MODELS[r["hinges"]]), ("degrees of freedom", "{freedoms}"),
    ("drift below 0.01", "{quiet_fs} fs"), ("stable", "{stable_fs} fs"),
)  # fmt: skip
table_of_rows(
    "dynamics-cost", "dynamics_cost.csv",
    ("structure", "{structure}"), ("atoms", "{atoms}"), ("hinges", "{hinges}"),
    ("energy and torques", "{energy_and_torques_ms:.2f}"), ("rest of the step", "{rest_ms:.2f}"),
    ("relative to the energy", "{rest_percent:.1f} %"),
)  # fmt: skip
table_of_rows(
    "dynamics-speed", "dynamics_speed.csv",
    ("structure", "{structure}"), ("residues", "{residues}"), ("solvent", lambda r: SOLVENTS[r["solvent"]]),
    ("OpenMM 2 fs", digits_of("openmm_2_fs")),
    *((f"{h} fs", digits_of(f"ours_{h}_fs")) for h in (2, 4, 8)),
    *((f"ratio at {h} fs", ratio_of(f"ratio_{h}_fs")) for h in (2, 4, 8)),
)  # fmt: skip


@table("dipeptide", "dipeptide.csv")
def dipeptide(rows: pd.DataFrame) -> str:
    """Shares of basins."""
    rows = rows.set_index(["method", "basin"])
    basins = {
        "beta, PII (phi < 0, psi > 60 or < -150)": "beta and PII (phi < 0; psi > 60 or < -150)",
        "alpha R (phi < 0, -150 < psi < 60)": "alpha R (phi < 0; psi between)",
        "phi > 0": "phi > 0",
    }

    def share(method: str, basin: str) -> str:
        r = rows.loc[(method, basin)]
        return f"{r.share_percent:.1f} +- {r.error_percent:.1f} %" if r.share_percent else "not visited"

    return markdown(
        ("basin", "rigid, quadrature", "rigid, Monte Carlo", "flexible, OpenMM"),
        ((shown, f"{rows.loc[('quadrature, Fixman', basin)].share_percent:.1f} %",
          share("rigid, Monte Carlo", basin), share("flexible, OpenMM", basin))
         for basin, shown in basins.items()),
    )  # fmt: skip


@table("dipeptide-words", "dipeptide.csv")
def dipeptide_words(rows: pd.DataFrame) -> str:
    """What the shares say."""
    of = rows[rows["basin"] == rows["basin"].iloc[0]].set_index("method")
    rigid, flexible = of.loc["rigid, Monte Carlo"], of.loc["flexible, OpenMM"]
    without, wrong = (of.loc[f"quadrature, {name}"].share_percent for name in ("no Fixman", "wrong sign"))
    return paragraph(
        f"Monte Carlo is {abs(rigid.errors_from_quadrature):.1f} standard errors from quadrature. About",
        f"{rigid.samples_per_independent_one:.0f} trajectories count as one independent sample. Without",
        f"Fixman's potential the first share would be {without:.1f} %, with a wrong sign {wrong:.1f} %. This",
        "molecule cannot distinguish them, but [other tests](tests.md#numbers-you-can-check) do. OpenMM's",
        f"seeds have between {flexible.lowest_seed_percent:.0f} and {flexible.highest_seed_percent:.0f} % in",
        "the first basin. Runs of this length are too short for the flexible molecule.",
    )
