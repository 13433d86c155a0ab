"""What a study knows: the loop's own posterior, and what of it reaches another experiment."""

import json

import numpy as np
import pytest
from scipy.linalg import block_diag

from pipeline.config.messages import ConfigError
from pipeline.config.study import Study
from pipeline.files.tables import as_csv
from pipeline.lattice.block_model import build_block_model
from pipeline.loop.documents import point_document, round_dataset
from pipeline.loop.fit import calibrated, fit, posterior_covariance
from pipeline.loop.gate import Gate
from pipeline.loop.problem import make_problem
from pipeline.predict.from_study import from_study, was_studied
from pipeline.predict.prediction import predict
