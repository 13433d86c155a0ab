"""Rule attribute: the loop on all calibration readings, to `attribution.json` and `rounds/`."""

from pathlib import Path

from pipeline.config.load import load_study
from pipeline.files.atomic import whole_file, write_json
from pipeline.files.netcdf import read_dataset
from pipeline.loop.problem import load_problem
from pipeline.loop.steps import attribution
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
study = load_study(snakemake.params.study)
problem, _ = load_problem(study, snakemake.params.experiments, snakemake.threads)
document, rounds = attribution(problem, read_dataset(snakemake.input.baseline))
folder = Path(snakemake.input.baseline).parent
for stale in folder.glob("round_*.nc"):
    stale.unlink()
for number, arrays in enumerate(rounds, start=1):
    with whole_file(folder / f"round_{number}.nc") as partial:
        arrays.to_netcdf(partial, engine="netcdf4")
write_json(snakemake.output.attribution, document)
