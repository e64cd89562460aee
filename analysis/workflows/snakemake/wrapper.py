"""Snakemake wrapper of ``protochain relax``."""

from snakemake.shell import shell

job = snakemake  # noqa: F821  # what Snakemake gives a wrapper
extra = job.params.get("extra", "")
record = job.output.get("record", "/dev/null")
log = job.log_fmt_shell(stdout=False, stderr=True)
shell(
    "protochain relax {job.input.model:q} -o {job.output.model:q} --threads {job.threads} --force --json"
    " {extra} > {record:q} {log} || [ $? -eq 3 ]"
)
