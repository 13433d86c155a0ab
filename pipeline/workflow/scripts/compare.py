"""Rule compare: replicates of two experiments to `comparison.json` and two tables."""

from pipeline.compare.comparison import (
    LOAD_CELL_COLUMNS,
    READING_COLUMNS,
    compare,
    load_cell_rows,
    reading_rows,
)
from pipeline.config.load import load_comparison, load_experiment
from pipeline.files.atomic import write_json, write_text
from pipeline.files.netcdf import read_dataset
from pipeline.files.tables import as_csv
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
document = compare(
    load_comparison(snakemake.params.comparison),
    [load_experiment(file) for file in snakemake.params.experiments],
    [read_dataset(path) for path in snakemake.input.replicates],
)
write_json(snakemake.output.numbers, document)
write_text(snakemake.output.readings, as_csv(READING_COLUMNS, reading_rows(document)))
write_text(snakemake.output.load_cells, as_csv(LOAD_CELL_COLUMNS, load_cell_rows(document)))
