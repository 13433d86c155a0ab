# The way to all pages.


rule index:
    input:
        calibrations=expand(
            rules.calibrate.output.calibration, experiment=CATALOG.experiments
        ),
        validations=expand(
            rules.validate.output.validation, experiment=CATALOG.experiments
        ),
        reports=expand(rules.report.output.report, experiment=CATALOG.experiments),
        studies=expand(rules.close_loop.output.closed_loop, study=CATALOG.studies),
        study_reports=expand(rules.study_report.output.report, study=CATALOG.studies),
        comparisons=expand(rules.compare.output.numbers, comparison=CATALOG.comparisons),
        comparison_reports=expand(
            rules.comparison_report.output.report, comparison=CATALOG.comparisons
        ),
        flow_law=rules.flow_law.output.figure,
    output:
        index=report(
            "<results>/index.html",
            caption="../report/index.rst",
            category="Overview",
            labels={"result": "index"},
        ),
        numbers="<results>/index.json",
    log:
        "<results>/logs/index.log",
    params:
        files=[CATALOG.file(name) for name in CATALOG.experiments],
        settings=[CATALOG.settings(name) for name in CATALOG.experiments],
        studies=list(CATALOG.studies),
        blind_scores=CATALOG.blind_scores(),
        code=source_digest("index"),
    message:
        "index"
    script:
        "../scripts/index.py"
