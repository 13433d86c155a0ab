"""Rule predict: replicates with sampled parameters and effects, to `prediction.nc` and `.json`."""

import json
from functools import partial
from pathlib import Path

from pipeline.config.load import check_measured, load_experiment, load_study, resolved
from pipeline.files.atomic import read_json, write_json
from pipeline.files.netcdf import read_dataset, write_dataset
from pipeline.montecarlo.checkpoints import Checkpoints
from pipeline.montecarlo.workers import Execution, crew
from pipeline.predict.from_study import from_study, was_studied
from pipeline.predict.knowledge import from_calibration, was_calibrated
from pipeline.predict.prediction import predict
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
experiment = load_experiment(snakemake.params.file)
experiments = {Path(p).stem: load_experiment(p) for p in snakemake.params.experiments}
if snakemake.params.study is None:
    calibrations = {c["experiment"]: c for c in map(read_json, snakemake.input.calibrations)}
    known = from_calibration([experiments[name] for name in calibrations], calibrations)
    was_fitted = partial(was_calibrated, calibrations[experiment.name])
else:
    study = load_study(snakemake.params.study)
    attribution = Path(snakemake.input.attribution)
    last = attribution.parent / "rounds" / f"round_{len(read_json(attribution)['gate'])}.nc"
    known = from_study(experiment, study, experiments, read_dataset(last))
    was_fitted = partial(was_studied, study, experiment.name)
execution = Execution(snakemake.threads, snakemake.resources.dask_scheduler)
code = snakemake.params.code + snakemake.params.effects
block_model = snakemake.input.block_model
with crew(execution, experiment.name):  # one session of a cluster for all levels
    dataset, document = predict(
        experiment,
        read_dataset(block_model),
        known,
        check_measured(experiment),
        was_fitted,
        execution,
        Checkpoints(snakemake.params.checkpoints, code),
    )
remarks = {"comment": " ".join(document["remarks"])} if document["remarks"] else {}
write_dataset(
    snakemake.output.samples,
    dataset,
    experiment,
    "predict",
    "Prediction with its uncertainty",
    [block_model],
    attributes={"prediction": json.dumps(resolved(experiment.prediction))} | remarks,
)
write_json(snakemake.output.numbers, document)
