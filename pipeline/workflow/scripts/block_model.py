"""Rule block_model: geometry and material to `block_model.nc`."""

import logging

from pipeline.config.load import load_experiment
from pipeline.effects import as_filled
from pipeline.files.netcdf import write_dataset
from pipeline.lattice.block_model import build_block_model
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
experiment = load_experiment(snakemake.params.file)
model = build_block_model(as_filled(experiment))
if model.attrs["lattice_notes"]:
    logging.warning("%s: %s", experiment.name, model.attrs["lattice_notes"])
write_dataset(
    snakemake.output.block_model,
    model,
    experiment,
    "block_model",
    "Block model",
    attributes=model.attrs,
)
