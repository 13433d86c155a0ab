# An experiment from its file to its report.


rule block_model:
    output:
        block_model="<results>/experiments/{experiment}/block_model.nc",
    log:
        "<results>/logs/experiments/{experiment}/block_model.log",
    params:
        file=lambda w: CATALOG.file(w.experiment),
        settings=lambda w: CATALOG.settings(w.experiment),
        code=source_digest("block_model"),
    message:
        "{wildcards.experiment}: block model"
    script:
        "../scripts/block_model.py"


rule calibrate:
    input:
        block_model=rules.block_model.output.block_model,
        sources=lambda w: CATALOG.source_calibration(w.experiment),
    output:
        calibration="<results>/experiments/{experiment}/calibration.json",
    log:
        "<results>/logs/experiments/{experiment}/calibrate.log",
    threads: lambda w: CATALOG.threads(w.experiment, workflow.cores)
    resources:
        dask_scheduler=config["dask_scheduler"] or "",
    params:
        file=lambda w: CATALOG.file(w.experiment),
        settings=lambda w: CATALOG.settings(w.experiment),
        code=source_digest("calibrate"),
    message:
        "{wildcards.experiment}: calibration"
    script:
        "../scripts/calibrate.py"


rule replicates:
    input:
        block_model=rules.block_model.output.block_model,
        calibration=rules.calibrate.output.calibration,
    output:
        replicates="<results>/experiments/{experiment}/replicates.nc",
        fields="<results>/experiments/{experiment}/fields.nc",
    log:
        "<results>/logs/experiments/{experiment}/replicates.log",
    threads: lambda w: CATALOG.threads(w.experiment, workflow.cores)
    resources:
        dask_scheduler=config["dask_scheduler"] or "",
    params:
        file=lambda w: CATALOG.file(w.experiment),
        settings=lambda w: CATALOG.settings(w.experiment),
        code=source_digest("replicates"),
        effects=lambda w: CATALOG.effects(w.experiment),
        checkpoints=lambda w: f"{RESULTS}/checkpoints/{w.experiment}",
    message:
        "{wildcards.experiment}: replicates"
    script:
        "../scripts/replicates.py"


rule aggregate:
    input:
        block_model=rules.block_model.output.block_model,
        replicates=rules.replicates.output.replicates,
        fields=rules.replicates.output.fields,
    output:
        statistics="<results>/experiments/{experiment}/statistics.nc",
        base_stress=report(
            "<results>/experiments/{experiment}/base_stress.csv",
            caption="../report/base_stress.rst",
            category="Experiments",
            subcategory="{experiment}",
            labels={"result": "base stress"},
        ),
    log:
        "<results>/logs/experiments/{experiment}/aggregate.log",
    params:
        file=lambda w: CATALOG.file(w.experiment),
        settings=lambda w: CATALOG.settings(w.experiment),
        code=source_digest("aggregate"),
    message:
        "{wildcards.experiment}: statistics"
    script:
        "../scripts/aggregate.py"


rule grade:
    input:
        block_model=rules.block_model.output.block_model,
        replicates=rules.replicates.output.replicates,
    output:
        grade="<results>/experiments/{experiment}/grade.nc",
        table="<results>/experiments/{experiment}/grade.csv",
    log:
        "<results>/logs/experiments/{experiment}/grade.log",
    params:
        file=lambda w: CATALOG.file(w.experiment),
        settings=lambda w: CATALOG.settings(w.experiment),
        code=source_digest("grade"),
    message:
        "{wildcards.experiment}: grade and dilution"
    script:
        "../scripts/grade.py"


rule validate:
    input:
        replicates=rules.replicates.output.replicates,
        calibration=rules.calibrate.output.calibration,
    output:
        validation="<results>/experiments/{experiment}/validation.json",
    log:
        "<results>/logs/experiments/{experiment}/validate.log",
    params:
        file=lambda w: CATALOG.file(w.experiment),
        settings=lambda w: CATALOG.settings(w.experiment),
        code=source_digest("validate"),
    message:
        "{wildcards.experiment}: validation"
    script:
        "../scripts/validate.py"


rule report:
    input:
        unpack(lambda w: CATALOG.prediction_page(w.experiment)),
        block_model=rules.block_model.output.block_model,
        calibration=rules.calibrate.output.calibration,
        replicates=rules.replicates.output.replicates,
        fields=rules.replicates.output.fields,
        statistics=rules.aggregate.output.statistics,
        base_stress=rules.aggregate.output.base_stress,
        validation=rules.validate.output.validation,
        grade=lambda w: CATALOG.grade_file(w.experiment, "nc"),
        grade_table=lambda w: CATALOG.grade_file(w.experiment, "csv"),
    output:
        report=report(
            "<results>/experiments/{experiment}/report.html",
            caption="../report/experiment.rst",
            category="Experiments",
            subcategory="{experiment}",
            labels={"result": "page"},
        ),
        data="<results>/experiments/{experiment}/report_data.csv",
    log:
        "<results>/logs/experiments/{experiment}/report.log",
    params:
        file=lambda w: CATALOG.file(w.experiment),
        settings=lambda w: CATALOG.settings(w.experiment),
        code=source_digest("report"),
    message:
        "{wildcards.experiment}: report"
    script:
        "../scripts/report.py"
