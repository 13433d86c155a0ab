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
        flow_law=rules.flow_law.output.figure,
    output:
        index="<results>/index.html",
        numbers="<results>/index.json",
    log:
        "<results>/logs/index.log",
    params:
        files=[CATALOG.file(name) for name in CATALOG.experiments],
        settings=[CATALOG.settings(name) for name in CATALOG.experiments],
        code=source_digest("index"),
    message:
        "index"
    script:
        "../scripts/index.py"
