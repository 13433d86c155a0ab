# The flow kernel alone, against what void diffusion should do.


rule flow_law:
    output:
        law=RESULTS + "/flow_law/flow_law.json",
        figure=RESULTS + "/flow_law/flow_law.svg",
        data=RESULTS + "/flow_law/flow_law.csv",
    log:
        RESULTS + "/logs/flow_law.log",
    params:
        code=source_digest("flow_law"),
    message:
        "Flow law: movement zone width against height"
    script:
        "../scripts/flow_law.py"
