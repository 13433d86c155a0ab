"""Rule residual: a study's readings against its calibrated baseline, to `residual.nc`."""

from pipeline.config.load import load_study
from pipeline.files.atomic import whole_file
from pipeline.files.netcdf import write_dataset
from pipeline.loop.problem import load_problem, measured_rows
from pipeline.loop.steps import residual
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
study = load_study(snakemake.params.study)
problem, experiments = load_problem(study, snakemake.params.experiments, snakemake.threads)
content, baseline = residual(problem, measured_rows(study, experiments))
with whole_file(snakemake.output.baseline) as partial:
    baseline.to_netcdf(partial, engine="netcdf4")
title = "Residuals of the calibrated baseline"
write_dataset(snakemake.output.residual, content, study, "residual", title)
