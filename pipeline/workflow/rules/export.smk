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


rule export_base_stress:
    input:
        block_model=rules.block_model.output.block_model,
        replicates=rules.replicates.output.replicates,
        fields=rules.replicates.output.fields,
    output:
        base_stress="<results>/experiments/{experiment}/export/base_stress.csv",
    log:
        "<results>/logs/experiments/{experiment}/export_base_stress.log",
    params:
        to="csv",
        code=source_digest("export"),
    message:
        "{wildcards.experiment}: table of base stress"
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
