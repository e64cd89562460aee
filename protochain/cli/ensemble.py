"""``protochain ensemble``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from protochain.chains.setup import Setup
from protochain.cli.frames import Chosen, Trajectory
from protochain.cli.options import AsJson, Input, check_outputs, named_after, with_settings
from protochain.cli.rows import conclude, print_rows
from protochain.core.markup import plural

if TYPE_CHECKING:
    from protochain.batches.ensembles import Clusters


@with_settings(
    setup="hinges root move rigid_protein engine device terms calculator solvent salt cutoff accuracy "
    "threads trust_forcefield"
)
def ensemble(
    source: Input,
    trajectory: Trajectory = None,
    frames: Chosen = None,
    by: Annotated[str, typer.Option(help="rmsd or torsions (phi and psi).")] = "rmsd",
    within: Annotated[
        float | None, typer.Option(help="Average distance in a cluster [default: 2 angstrom, or 30 degrees].")
    ] = None,
    measure: Annotated[str, typer.Option(help="Selection of atoms for the RMSD.")] = "name CA",
    after: Annotated[
        Path | None, typer.Option(help="Frames after a run, for fluctuations before and after.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Medoids, as models [default: NAME.medoids.pdb].")
    ] = None,
    csv: Annotated[Path | None, typer.Option(help="CSV to write: cluster of each frame.")] = None,
    residues: Annotated[Path | None, typer.Option(help="CSV to write: fluctuation of each residue.")] = None,
    as_json: AsJson = False,
    *,
    setup: Setup,
) -> None:
    """Cluster the frames of one structure. Write medoids and fluctuations of residues."""
    from protochain.batches.ensembles import cluster_frames
    from protochain.structure import save

    output = output or Path(f"{named_after(source)[0]}.medoids.pdb")
    check_outputs([source, trajectory, after], [output, csv, residues], setup)

    def read(path: Path | None) -> "Clusters":
        return cluster_frames(source, path, frames, by=by, within=within, measure=measure, **vars(setup))

    clusters = read(trajectory)
    table = clusters.fluctuations
    if after:
        moved = read(after).fluctuations["ca_fluctuation_angstrom"]
        table = table.assign(ca_fluctuation_after_angstrom=moved)
    save(clusters.medoids, output)
    members = clusters.table
    rows = [
        {
            "cluster": k + 1, "frames": int((members["cluster"] == k + 1).sum()), "medoid": int(frame),
            "distance_mean": float(members.loc[members["cluster"] == k + 1, "distance_to_medoid"].mean()),
            "message": "",
        }
        for k, frame in enumerate(members.loc[members["medoid"]].sort_values("cluster")["frame"])
    ]  # fmt: skip

    def show(rows: list[dict[str, object]]) -> None:
        unit = "angstrom" if by == "rmsd" else "degrees"
        headings = ("cluster", "frames", "medoid", f"mean distance, {unit}")
        print_rows(headings, [[row[key] for key in (*row,)[:4]] for row in rows], texts=0)
        worst = table.nlargest(3, "ca_fluctuation_angstrom")
        names = [f"{r.chain}:{r.residue} {r.ca_fluctuation_angstrom:.1f}" for r in worst.itertuples()]
        print(f"{plural(len(members), 'frame')}; C-alphas that fluctuate most, angstrom: {', '.join(names)}")

    tables = {csv: lambda: members, residues: lambda: table}
    conclude(rows, tables, show, as_json, [output], input=str(source), by=by)
