# Both targets set up what they need by themselves: a Python environment in .venv with this checkout in it.
PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin
OUT := out
# These start nodes and mostly wait for them. Two files at a time: more would keep the nodes from their clock.
LIVE_TESTS := test/dds test/processes

.PHONY: demo test lint clean

demo: $(VENV)/.ready
	$(RUN)/python tools/demo $(OUT)

test: $(VENV)/.ready lint
	$(RUN)/python -m pytest -q -n auto --dist worksteal $(addprefix --ignore ,$(LIVE_TESTS))
	$(RUN)/python -m pytest -q -n 2 --dist loadfile --durations=12 $(LIVE_TESTS)

lint: $(VENV)/.ready
	$(RUN)/ruff check .
	$(RUN)/mypy

$(VENV)/.ready: setup.py
	./tools/make-environment $(PYTHON) $(VENV)
	$(RUN)/python -m pip install --quiet --disable-pip-version-check --use-pep517 --editable ".[test]"
	@touch $@

clean:
	rm -rf $(VENV) $(OUT) build install log *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
