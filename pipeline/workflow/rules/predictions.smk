# What an experiment's readings will be, with all that is not known of it.


rule predict:
    input:
        unpack(lambda w: CATALOG.prediction_inputs(w.experiment)),
        block_model=rules.block_model.output.block_model,
    output:
        samples="<results>/experiments/{experiment}/prediction.nc",
        numbers="<results>/experiments/{experiment}/prediction.json",
    log:
        "<results>/logs/experiments/{experiment}/predict.log",
    wildcard_constraints:
        experiment="|".join(CATALOG.predicted) or "there is no prediction",
    threads: lambda w: CATALOG.prediction_threads(w.experiment, workflow.cores)
    resources:
        dask_scheduler=config["dask_scheduler"] or "",
    params:
        file=lambda w: CATALOG.file(w.experiment),
        study=lambda w: CATALOG.prediction_study(w.experiment),
        experiments=lambda w: CATALOG.prediction_experiments(w.experiment),
        settings=lambda w: CATALOG.prediction_settings(w.experiment),
        code=source_digest("predict"),
        effects=effects_digest(),
        checkpoints=lambda w: f"{RESULTS}/checkpoints/{w.experiment}.prediction",
    message:
        "{wildcards.experiment}: prediction"
    script:
        "../scripts/predict.py"


rule prediction_report:
    input:
        samples=rules.predict.output.samples,
        numbers=rules.predict.output.numbers,
    output:
        report=report(
            "<results>/experiments/{experiment}/prediction.html",
            caption="../report/prediction.rst",
            category="Experiments",
            subcategory="{experiment}",
            labels={"result": "prediction"},
        ),
        data="<results>/experiments/{experiment}/prediction_data.csv",
    log:
        "<results>/logs/experiments/{experiment}/prediction_report.log",
    wildcard_constraints:
        experiment="|".join(CATALOG.predicted) or "there is no prediction",
    params:
        file=lambda w: CATALOG.file(w.experiment),
        settings=lambda w: CATALOG.settings(w.experiment),
        code=source_digest("prediction_report"),
    message:
        "{wildcards.experiment}: page of the prediction"
    script:
        "../scripts/prediction_report.py"
