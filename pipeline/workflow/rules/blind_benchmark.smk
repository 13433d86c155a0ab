# The loop's test on data with undeclared effects in them; no part of `all`.


rule blind_worlds:
    output:
        runs="<results>/blind_benchmark/runs.json",
    log:
        "<results>/logs/blind_worlds.log",
    threads: workflow.cores
    params:
        worlds=int(config["blind_worlds"]),
        hard_nulls=int(config["blind_hard_nulls"]),
        attacks=int(config["blind_attacks"]),
        seed=lambda w: blind_seed(config),
        code=source_digest("blind_worlds") + effects_digest(),
    message:
        "Blind benchmark: {params.worlds} worlds"
    script:
        "../scripts/blind_worlds.py"


rule blind_benchmark:
    input:
        runs=rules.blind_worlds.output.runs,
    output:
        scores="<results>/blind_benchmark/scores.json",
        report=report(
            "<results>/blind_benchmark/report.html",
            caption="../report/blind_benchmark.rst",
            category="Blind benchmark",
            labels={"result": "page"},
        ),
        data="<results>/blind_benchmark/report_data.csv",
    log:
        "<results>/logs/blind_benchmark.log",
    params:
        code=source_digest("blind_benchmark"),
    message:
        "Blind benchmark: scores"
    script:
        "../scripts/blind_benchmark.py"
