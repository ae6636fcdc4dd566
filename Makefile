# Both targets set up what they need by themselves: a Python environment in .venv with this checkout in it.
PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin
# Versions as tested: a new one of some library fails nobody's test of something else.
PIP := $(RUN)/python -m pip install --quiet --disable-pip-version-check --use-pep517 --constraint constraints.txt
OUT := out
# Containers often forbid Python to keep bytecode. Then each process compiles all that it imports, and starts in twice the time.
export PYTHONDONTWRITEBYTECODE :=
# These start nodes and mostly wait for them. Two files at a time: more would keep the nodes from their clock.
LIVE_TESTS := test/dds test/processes

.PHONY: demo test check test-live test-rest test-effects mutants coverage prove reproduce site lint clean

demo: $(VENV)/.ready
	$(RUN)/python tools/demo $(OUT)

# What computes does so beside what waits, and gives way to it. Tests run as many at once as there are processors: no further
# threads in each.
test: export OPENBLAS_NUM_THREADS := 1
test: $(VENV)/.ready
	$(MAKE) --no-print-directory -j 2 lint test-effects
	$(MAKE) --no-print-directory -j 2 test-live test-rest

# For the loop of a developer: style, unused code, types and the laws of the physics.
FAST_LAWS := test/model test/estimator test/vehicle test/route test/text test/effects/test_laws.py \
	test/learning/test_filter.py
check: export OPENBLAS_NUM_THREADS := 1
check: lint
	$(RUN)/python -m pytest -q -n auto --dist worksteal -m "not long" $(FAST_LAWS)

test-live: $(VENV)/.ready
	@log=$$(mktemp); $(RUN)/python -m pytest -q -n 2 --dist loadfile --durations=12 $(LIVE_TESTS) > $$log 2>&1; \
	status=$$?; cat $$log; rm $$log; exit $$status

test-rest: $(VENV)/.ready
	nice -n 19 $(RUN)/python -m pytest -q -n auto --dist worksteal $(addprefix --ignore ,$(LIVE_TESTS) test/effects)

test-effects: $(VENV)/.ready
	$(RUN)/python -m pytest -q test/effects

# Small faults put into a module one at a time: how many of them its tests find. By hand: it takes half an hour.
mutants: $(VENV)/.ready
	$(PIP) --editable ".[mutation]"
	$(RUN)/python tools/mutants

# How much of the rooms that read what comes from outside their tests run, into CONTRIBUTING.md. Apart from the tests, which it would slow down.
coverage: $(VENV)/.ready
	$(PIP) --editable ".[coverage]"
	nice -n 19 $(RUN)/python tools/coverage --write

# How often the diagnosis is right, wrong or silent on drives whose cause is sealed: some hours. Other proofs: python -m proofs.
prove: $(VENV)/.ready
	nice -n 19 $(RUN)/python -m proofs own --quick -o $(OUT)/proof

# The paper's figures, and which of its claims hold.
reproduce: $(VENV)/.ready
	$(RUN)/python -m proofs reproduce -o $(OUT)/figures

# The documentation of this version as a site in out/site/VERSION, with what the examples print; a link that leads nowhere is an error.
site: $(VENV)/.ready
	$(PIP) --editable ".[docs]"
	nice -n 19 $(RUN)/python tools/site $(OUT)/site

lint: $(VENV)/.ready
	$(RUN)/ruff check .
	$(RUN)/ruff format --check --quiet .
	$(RUN)/vulture
	$(RUN)/mypy

$(VENV)/.ready: setup.py constraints.txt
	./tools/make-environment $(PYTHON) $(VENV)
	$(PIP) --no-compile --editable ".[test]"  # Python compiles what is imported; pip would compile all
	@touch $@

clean:
	rm -rf $(VENV) $(OUT) build install log *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
