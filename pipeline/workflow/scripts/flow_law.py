"""Rule flow_law: growth of isolated movement zones, to `flow_law.json`, `.csv` and `.svg`."""

from pipeline.files.atomic import write_json, write_text
from pipeline.validate.flow_law import flow_law_figure, flow_law_table, measure_flow_law
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
law = measure_flow_law()
write_text(snakemake.output.figure, flow_law_figure(law))
write_text(snakemake.output.data, flow_law_table(law))
write_json(snakemake.output.law, law)
