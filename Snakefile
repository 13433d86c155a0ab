# Wiring only: what exists, what is wanted. Rules are in pipeline/workflow/rules/.
from snakemake.utils import min_version

min_version("9.19")


configfile: "workflow_configs/default.yaml"


report: "pipeline/workflow/report/workflow.rst"


include: "pipeline/workflow/rules/common.smk"
include: "pipeline/workflow/rules/experiments.smk"
include: "pipeline/workflow/rules/export.smk"
include: "pipeline/workflow/rules/flow_law.smk"
include: "pipeline/workflow/rules/effects.smk"
include: "pipeline/workflow/rules/studies.smk"
include: "pipeline/workflow/rules/predictions.smk"
include: "pipeline/workflow/rules/comparisons.smk"
include: "pipeline/workflow/rules/index.smk"
include: "pipeline/workflow/rules/blind_benchmark.smk"


rule all:
    default_target: True
    input:
        rules.effect_catalogue.output,
        rules.index.output,
