"""From a mine's files to an experiment: block models, drawpoints, schedules, measured stress."""
