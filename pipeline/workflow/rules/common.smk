from snakemake.exceptions import WorkflowError

from pipeline.config.messages import ConfigError
from pipeline.workflow.catalog import Catalog, blind_seed
from pipeline.workflow.source import effects_digest, source_digest

try:
    CATALOG = Catalog(config)
except ConfigError as error:
    raise WorkflowError(str(error)) from None
RESULTS = CATALOG.results

# A job's threads are its replicates or processes. Snakemake tells linear algebra to use as many
# again, which makes jobs several times slower, so a script starts with one for each library.
# Dask is for clusters alone, see pipeline/__init__.py.
shell.prefix(
    "export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1 NUMBA_NUM_THREADS=1"
    + ("; " if config["dask_scheduler"] else " BLOCK_CAVE_WITHOUT_DASK=1; ")
)


pathvars:
    results=RESULTS,


wildcard_constraints:
    experiment="|".join(CATALOG.experiments),
    study="|".join(CATALOG.studies) or "there is no study",
    comparison="|".join(CATALOG.comparisons) or "there is no comparison",
