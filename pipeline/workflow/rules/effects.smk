# The catalogue of effects, with what each does.


rule effect_pictures:
    output:
        pictures="<results>/effects/pictures.nc",
    log:
        "<results>/logs/effect_pictures.log",
    threads: workflow.cores
    params:
        code=source_digest("effect_pictures"),
        effects=effects_digest(),
    message:
        "Effects: pictures"
    script:
        "../scripts/effect_pictures.py"


rule effect_catalogue:
    input:
        pictures=rules.effect_pictures.output.pictures,
    output:
        page=report(
            "<results>/effects/index.html",
            caption="../report/effects.rst",
            category="Effects",
            labels={"result": "catalogue"},
        ),
        numbers="<results>/effects/index.json",
    log:
        "<results>/logs/effect_catalogue.log",
    params:
        code=source_digest("effect_catalogue"),
        effects=effects_digest(),
    message:
        "Effects: catalogue"
    script:
        "../scripts/effect_catalogue.py"
