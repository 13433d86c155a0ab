# Two draw experiments beside each other.


rule compare:
    input:
        replicates=lambda w: CATALOG.compared_replicates(w.comparison),
    output:
        numbers="<results>/comparisons/{comparison}/comparison.json",
        readings="<results>/comparisons/{comparison}/comparison.csv",
        load_cells=report(
            "<results>/comparisons/{comparison}/load_cells.csv",
            caption="../report/comparison.rst",
            category="Comparisons",
            subcategory="{comparison}",
            labels={"result": "load cells"},
        ),
    log:
        "<results>/logs/comparisons/{comparison}/compare.log",
    params:
        comparison=lambda w: CATALOG.comparison_file(w.comparison),
        experiments=lambda w: CATALOG.compared_files(w.comparison),
        settings=lambda w: CATALOG.comparison_settings(w.comparison),
        code=source_digest("compare"),
    message:
        "{wildcards.comparison}: comparison"
    script:
        "../scripts/compare.py"


rule comparison_report:
    input:
        numbers=rules.compare.output.numbers,
    output:
        report=report(
            "<results>/comparisons/{comparison}/report.html",
            caption="../report/comparison.rst",
            category="Comparisons",
            subcategory="{comparison}",
            labels={"result": "page"},
        ),
        data="<results>/comparisons/{comparison}/report_data.csv",
    log:
        "<results>/logs/comparisons/{comparison}/comparison_report.log",
    params:
        code=source_digest("comparison_report"),
    message:
        "{wildcards.comparison}: report"
    script:
        "../scripts/comparison_report.py"
