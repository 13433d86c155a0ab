"""Rule effect_pictures: what each effect does, to `effects/pictures.nc`."""

from pipeline.files.atomic import whole_file
from pipeline.montecarlo.workers import Execution
from pipeline.sensitivity.pictures import effect_pictures
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
pictures = effect_pictures(Execution(snakemake.threads))
with whole_file(snakemake.output.pictures) as partial:
    pictures.to_netcdf(partial, engine="netcdf4")
