from snakemake.exceptions import WorkflowError

from pipeline.config.messages import ConfigError
from pipeline.workflow.catalog import Catalog, blind_seed, effects_digest, source_digest

try:
    CATALOG = Catalog(config)
except ConfigError as error:
    raise WorkflowError(str(error)) from None
RESULTS = CATALOG.results


pathvars:
    results=RESULTS,


wildcard_constraints:
    experiment="|".join(CATALOG.experiments),
    study="|".join(CATALOG.studies) or "there is no study",
