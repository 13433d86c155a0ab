# An experiment's results as files that other tools open; made only when asked for.


rule export_fields:
    input:
        block_model=rules.block_model.output.block_model,
        fields=rules.replicates.output.fields,
    output:
        vtk=directory("<results>/experiments/{experiment}/export/vtk"),
    log:
        "<results>/logs/experiments/{experiment}/export_fields.log",
    params:
        to="vtk",
        code=source_digest("export"),
    message:
        "{wildcards.experiment}: VTK image data"
    script:
        "../scripts/export.py"


rule export_block_model:
    input:
        block_model=rules.block_model.output.block_model,
        fields=rules.replicates.output.fields,
    output:
        block_model="<results>/experiments/{experiment}/export/block_model.csv",
    log:
        "<results>/logs/experiments/{experiment}/export_block_model.log",
    params:
        to="block_model",
        code=source_digest("export"),
    message:
        "{wildcards.experiment}: block model as CSV"
    script:
        "../scripts/export.py"


rule export_vulcan:
    input:
        block_model=rules.block_model.output.block_model,
        fields=rules.replicates.output.fields,
    output:
        block_model="<results>/experiments/{experiment}/export/block_model_vulcan.csv",
    log:
        "<results>/logs/experiments/{experiment}/export_vulcan.log",
    params:
        to="vulcan",
        code=source_digest("export"),
    message:
        "{wildcards.experiment}: block model for Vulcan"
    script:
        "../scripts/export.py"
