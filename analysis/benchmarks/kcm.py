"""Tables and words of the study of KCM against dynamics, from the runs that `protochain bench kcm` has made.

`protochain bench kcm FILES -o DIR` adds runs to DIR/runs.csv for as long as one likes; this makes everything
else anew from them, in seconds.
"""

from pathlib import Path

import pandas as pd
from made import RESULTS, parser, write

from protochain.analysis.studies import kcm, kcm_plots, kcm_summary
from protochain.results.tables import save

options = parser(__doc__)
options.add_argument(
    "--runs", type=Path, default=RESULTS / "kcm_runs.csv", metavar="CSV", help="table of runs"
)


def main() -> None:
    """Write the tables and the figure."""
    given = options.parse_args()
    runs = kcm.stored(given.runs)
    made = kcm_summary.tables(runs)
    for name, table in made.items():
        print(f"\n{name}\n\n{table.to_string(max_rows=40)}")
        if given.output:
            write(table, given.output / f"kcm_{name}.csv", [given.runs.name])
    traces = given.runs.with_name(given.runs.name.replace("runs", "traces"))
    if given.output:
        save(
            given.output, {"kcm.png": kcm_plots.plot(made, pd.read_csv(traces) if traces.exists() else None)}
        )


if __name__ == "__main__":
    main()
