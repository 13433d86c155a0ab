# A study from its readings to the improved model: residual → effect → error before and after.


rule residual:
    output:
        residual="<results>/studies/{study}/residual.nc",
        baseline="<results>/studies/{study}/rounds/baseline.nc",
    log:
        "<results>/logs/studies/{study}/residual.log",
    threads: workflow.cores
    params:
        study=lambda w: CATALOG.study_file(w.study),
        experiments=lambda w: CATALOG.study_experiments(w.study),
        settings=lambda w: CATALOG.study_settings(w.study),
        code=source_digest("residual"),
        effects=effects_digest(),
    message:
        "{wildcards.study}: residual"
    script:
        "../scripts/residual.py"


rule attribute:
    input:
        baseline=rules.residual.output.baseline,
    output:
        attribution="<results>/studies/{study}/attribution.json",
    log:
        "<results>/logs/studies/{study}/attribute.log",
    threads: workflow.cores
    params:
        study=lambda w: CATALOG.study_file(w.study),
        experiments=lambda w: CATALOG.study_experiments(w.study),
        settings=lambda w: CATALOG.study_settings(w.study),
        code=source_digest("attribute"),
        effects=effects_digest(),
    message:
        "{wildcards.study}: attribution"
    script:
        "../scripts/attribute.py"


rule close_loop:
    input:
        baseline=rules.residual.output.baseline,
        attribution=rules.attribute.output.attribution,
    output:
        closed_loop="<results>/studies/{study}/closed_loop.json",
        predictions="<results>/studies/{study}/predictions.json",
    log:
        "<results>/logs/studies/{study}/close_loop.log",
    threads: workflow.cores
    params:
        study=lambda w: CATALOG.study_file(w.study),
        experiments=lambda w: CATALOG.study_experiments(w.study),
        settings=lambda w: CATALOG.study_settings(w.study),
        code=source_digest("close_loop"),
        effects=effects_digest(),
    message:
        "{wildcards.study}: closing the loop"
    script:
        "../scripts/close_loop.py"


rule improved:
    input:
        attribution=rules.attribute.output.attribution,
        closed_loop=rules.close_loop.output.closed_loop,
    output:
        improved="<results>/studies/{study}/improved.json",
    log:
        "<results>/logs/studies/{study}/improved.log",
    threads: workflow.cores
    params:
        study=lambda w: CATALOG.study_file(w.study),
        experiments=lambda w: CATALOG.study_experiments(w.study),
        settings=lambda w: CATALOG.study_settings(w.study),
        code=source_digest("improved"),
        effects=effects_digest(),
    message:
        "{wildcards.study}: the improved model beside the old"
    script:
        "../scripts/improved.py"


rule study_report:
    input:
        residual=rules.residual.output.residual,
        attribution=rules.attribute.output.attribution,
        closed_loop=rules.close_loop.output.closed_loop,
        predictions=rules.close_loop.output.predictions,
        improved=rules.improved.output.improved,
    output:
        report=report(
            "<results>/studies/{study}/report.html",
            caption="../report/study.rst",
            category="Studies",
            subcategory="{study}",
            labels={"result": "page"},
        ),
        data="<results>/studies/{study}/report_data.csv",
    log:
        "<results>/logs/studies/{study}/study_report.log",
    params:
        study=lambda w: CATALOG.study_file(w.study),
        settings=lambda w: CATALOG.study_settings(w.study),
        code=source_digest("study_report"),
        effects=effects_digest(),
    message:
        "{wildcards.study}: report"
    script:
        "../scripts/study_report.py"
