# The flow kernel alone, against what void diffusion should do.


rule flow_law:
    output:
        law="<results>/flow_law/flow_law.json",
        figure="<results>/flow_law/flow_law.svg",
        data="<results>/flow_law/flow_law.csv",
    log:
        "<results>/logs/flow_law.log",
    params:
        code=source_digest("flow_law"),
    message:
        "Flow law: movement zone width against height"
    script:
        "../scripts/flow_law.py"
