# `make` sets everything up and runs the main job; `make test` sets everything up and tests it;
# `make setup` does no more than that.
PYTHON ?= python3
VENV := .venv
TARGETS ?=
PYTEST_ARGS ?= -n 2 --dist loadfile --no-loadscope-reorder

.PHONY: run setup test clean

run: $(VENV)/installed
	@PATH="$(CURDIR)/$(VENV)/bin:$$PATH" python -m pipeline.workflow.run $(TARGETS)

setup: $(VENV)/installed

test: $(VENV)/installed-test
	@PATH="$(CURDIR)/$(VENV)/bin:$$PATH" python -m pytest $(PYTEST_ARGS)

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/installed: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(VENV)/bin/pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	@touch $@

$(VENV)/installed-test: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(VENV)/bin/pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[test]"
	@touch $@ $(VENV)/installed

clean:
	rm -rf $(VENV)
