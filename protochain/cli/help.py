"""Help of a command: the most common options, then all others by subject."""

from importlib.resources import files
from itertools import groupby
from typing import Any

from typer.core import TyperCommand

_FIRST = (
    "output", "method", "methods", "preset", "interface", "reference", "by", "ligands", "report",
    "trajectory", "frames", "scan", "into", "relax", "resume",
)  # fmt: skip
"""Most common options, in this order."""
_FEW = 5
_GROUPS = {
    "Structure": "model assembly altloc chains keep exclude disulfide no_disulfide ph strict frames "
    "standard_residues cap keep_hydrogens",
    "Force field": "calculator forcefield solvent salt terms engine cutoff accuracy trust_forcefield",
    "Ligands": "ligands ligand_charges ligand_out protein_out free_ligands score_only posebusters",
    "Output": "output report trace trajectory as_json csv residues changes force one_file checkpoint resume "
    "restraint_csv rank verbose quiet",
    "Machine": "device threads workers scheduler time_limit",
}
_ORDER = ("Arguments", "Used most", "Structure", "Force field", "Method", "Ligands", "Output", "Machine")


def examples() -> dict[str, list[str]]:
    """Command lines of each command, for files of the folder ``structures``, from ``examples.txt``."""
    lines = (files("protochain.cli") / "examples.txt").read_text(encoding="utf-8").splitlines()
    return {name: [*group] for name, group in groupby(lines, key=lambda line: line.split()[0])}


class Command(TyperCommand):
    """A command whose help has its options in groups, and examples."""

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the examples, a line each."""
        lines = examples()["minimise" if self.name == "minimize" else str(self.name)]
        with formatter.section("Examples"):
            formatter.write("".join(f"  protochain {line}\n" for line in lines))

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments and options, with a section for each group."""
        group = {name: title for title, names in _GROUPS.items() for name in names.split()}
        params = self.get_params(ctx)
        options = {param.name for param in params if param.param_type_name == "option"}
        first = [name for name in _FIRST if name in options][:_FEW]
        rows: dict[str, list[tuple[str, str]]] = {title: [] for title in _ORDER}
        for param in sorted(
            params, key=lambda option: first.index(option.name) if option.name in first else _FEW
        ):
            record = param.get_help_record(ctx)
            if record:
                title = "Used most" if param.name in first else group.get(param.name, "Method")
                rows["Arguments" if param.param_type_name == "argument" else title].append(record)
        for title, records in rows.items():
            if records:
                with formatter.section(title):
                    formatter.write_dl(records)
