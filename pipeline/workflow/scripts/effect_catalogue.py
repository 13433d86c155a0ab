"""Rule effect_catalogue: `effects/pictures.nc` to the catalogue page."""

from pipeline.files.netcdf import read_dataset
from pipeline.report.catalogue import write_catalogue
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
write_catalogue(
    read_dataset(snakemake.input.pictures), snakemake.output.page, snakemake.output.numbers
)
