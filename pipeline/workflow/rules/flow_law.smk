# The flow kernel alone, against what void diffusion should do.


rule flow_law:
    output:
        law="<results>/flow_law/flow_law.json",
        figure=report(
            "<results>/flow_law/flow_law.svg",
            caption="../report/flow_law.rst",
            category="Flow law",
            labels={"result": "figure"},
        ),
        data="<results>/flow_law/flow_law.csv",
    log:
        "<results>/logs/flow_law.log",
    params:
        code=source_digest("flow_law"),
    message:
        "Flow law: movement zone width against height"
    script:
        "../scripts/flow_law.py"
