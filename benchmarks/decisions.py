# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What was weighed in docs/decisions: ours and a library's, each at the same task. `python benchmarks/decisions.py [NAME ...]`.

statsmodels, casadi, cython and pythran serve this comparison alone and are in none of the extras: `pip install` them.
"""

from __future__ import annotations

import ast
import importlib.util
import inspect
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections import namedtuple
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import attrs
import numpy as np
from mcap.writer import CompressionType, Writer
from measuring import START_NS, alternated, median_ratio
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from trackres_ros.arrays import Array
from trackres_ros.building import all_entries, built
from trackres_ros.diagnosis.inference.noise import Noise, estimate_noise
from trackres_ros.diagnosis.prepare import speed_smoothing
from trackres_ros.errors import InputError
from trackres_ros.estimator.columns import Motion
from trackres_ros.files.file_sets import file_set
from trackres_ros.files.own_files import write
from trackres_ros.output.mcap import BagWriter
from trackres_ros.recording.bindings import Topics
from trackres_ros.recording.cdr import FieldReader, Template
from trackres_ros.recording.message_types import definitions

STORE = get_typestore(Stores.LATEST)
TWIST = "geometry_msgs/msg/TwistStamped"
FIELD = "twist.linear.x"
LIKE_THE_LAST = 0.9  # correlation of a residual with the one before: that of torques at 10 Hz
TAILS = 2.5  # degrees of freedom of the innovations: spikes, as a measured torque has them


def twist(speed: float = 0.0, stamp_ns: int = 0) -> object:
    """A message with one number in it."""
    types = STORE.types
    zero = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    linear = types["geometry_msgs/msg/Vector3"](speed, 0.0, 0.0)
    time = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 1_000_000_000))
    return types[TWIST](types["std_msgs/msg/Header"](time, "base_link"), types["geometry_msgs/msg/Twist"](linear, zero))


def cdr(messages: int = 50_000, repeats: int = 5) -> dict[str, float]:
    """One number and the stamp out of serialised messages: a column of many at once, and each message whole by rosbags."""
    template = Template(bytes(STORE.serialize_cdr(twist(), TWIST)), definitions(STORE.fielddefs, TWIST), TWIST, [FIELD])
    rows = np.empty((messages, len(STORE.serialize_cdr(twist(), TWIST))), np.uint8)
    template.fill(rows, 0, START_NS + np.arange(messages), np.arange(messages, dtype=float)[:, None])
    raws = [row.tobytes() for row in rows]

    def ours() -> list[float]:
        reader = FieldReader(definitions(STORE.fielddefs, TWIST), TWIST, [FIELD])
        return list(reader.decode(raws).value[:, 0])

    def library() -> list[float]:
        return [message.twist.linear.x for message in (STORE.deserialize_cdr(raw, TWIST) for raw in raws)]

    assert ours() == library()
    times = alternated({"ours": ours, "rosbags": library}, repeats)
    return {
        "ours [us a message]": statistics.median(times["ours"]) / messages * 1e6,
        "rosbags [us a message]": statistics.median(times["rosbags"]) / messages * 1e6,
        "rosbags over ours": median_ratio(times["rosbags"], times["ours"]),
    }


def mcap(messages: int = 50_000, repeats: int = 5) -> dict[str, float]:
    """Messages that differ in stamp and number into a file: block by block, and one by one by the library of the format.

    Neither compresses, and what the library writes is serialised beforehand: that is not in its time.
    """
    stamps, values = START_NS + 10_000_000 * np.arange(messages), np.arange(messages, dtype=float)[:, None]
    with tempfile.TemporaryDirectory() as folder:
        own, other = Path(folder) / "own.mcap", Path(folder) / "other.mcap"

        def ours() -> None:
            with BagWriter(own) as bag:
                topic = bag.topic("/speed", TWIST, twist(), [FIELD])
                for rows in np.array_split(np.arange(messages), max(1, messages // 8192)):
                    bag.write_block(topic, stamps[rows], stamps[rows], values[rows])

        raws = [bytes(STORE.serialize_cdr(twist(float(v), int(t)), TWIST)) for v, t in zip(values[:, 0], stamps, strict=True)]

        def library() -> None:
            with other.open("wb") as file:
                writer = Writer(file, compression=CompressionType.NONE)
                writer.start("ros2", "trackres_ros")
                schema = writer.register_schema(TWIST, "ros2msg", STORE.generate_msgdef(TWIST)[0].encode())
                channel = writer.register_channel("/speed", "cdr", schema)
                for stamp, raw in zip(stamps.tolist(), raws, strict=True):
                    writer.add_message(channel, stamp, raw, stamp)
                writer.finish()

        times = alternated({"ours": ours, "library": library}, repeats)
        sizes = own.stat().st_size, other.stat().st_size
    return {
        "ours [us a message]": statistics.median(times["ours"]) / messages * 1e6,
        "mcap [us a message]": statistics.median(times["library"]) / messages * 1e6,
        "mcap over ours": median_ratio(times["library"], times["ours"]),
        "ours, size of the file [bytes a message]": sizes[0] / messages,
        "mcap, size of the file [bytes a message]": sizes[1] / messages,
    }


def noise(samples: int = 3000, draws: int = 40) -> dict[str, float]:
    """The noise of residuals with spikes: how well it is found, and how likely a fresh draw is by what was found."""
    from statsmodels.tsa.ar_model import AutoReg

    random = np.random.default_rng(1)

    def draw() -> np.ndarray:
        series, shocks = np.zeros(samples), random.standard_t(TAILS, samples)
        for i in range(1, samples):
            series[i] = LIKE_THE_LAST * series[i - 1] + shocks[i]
        return series

    def density(found: Noise, series: np.ndarray) -> float:
        white = np.convolve(series, [1.0, *-found.phi], "valid") / found.std
        return float(np.mean(found.log_density(white)))

    def normal(series: np.ndarray) -> Noise:
        fitted = AutoReg(series, 1, trend="n").fit()
        return Noise(fitted.params, float(np.sqrt(fitted.sigma2)), 1e6)  # so many degrees of freedom are the normal law

    whole = np.ones(samples, bool)
    by: dict[str, Callable[[np.ndarray], Noise]] = {"ours": lambda x: estimate_noise([x], [whole]), "statsmodels": normal}
    errors: dict[str, list[float]] = {name: [] for name in by}
    likely: dict[str, list[float]] = {name: [] for name in by}
    for _ in range(draws):
        series, fresh = draw(), draw()
        for name, fit in by.items():
            found = fit(series)
            errors[name].append(float(found.phi.sum()) - LIKE_THE_LAST)
            likely[name].append(density(found, fresh))
    series = draw()
    times = alternated({name: lambda fit=fit: fit(series) for name, fit in by.items()}, 5)  # type: ignore[misc]
    return {
        **{f"{name}: error of the correlation, rms": float(np.sqrt(np.mean(np.square(errors[name])))) for name in by},
        "log-density of a fresh draw, ours less statsmodels [a sample]": float(
            np.mean(np.subtract(likely["ours"], likely["statsmodels"]))
        ),
        **{f"{name}: time of a fit [ms]": statistics.median(times[name]) * 1e3 for name in by},
    }


@attrs.frozen
class Line:
    """A line of a topics file, as attrs checks it."""

    topic: str = attrs.field(default="/a", validator=attrs.validators.instance_of(str))
    field: str = attrs.field(default="data", validator=attrs.validators.instance_of(str))
    scale: float = attrs.field(
        default=1.0,
        validator=[attrs.validators.instance_of((int, float)), attrs.validators.ge(-1e300), attrs.validators.le(1e300)],
    )
    stamp: str = attrs.field(default="log", validator=attrs.validators.in_(("header", "log")))
    delay_s: float = attrs.field(
        default=0.0, validator=[attrs.validators.instance_of((int, float)), attrs.validators.ge(0.0), attrs.validators.le(10.0)]
    )


WRONG = (
    ({"scal": 1.0}, ("scal", "scale")),
    ({"stamp": "heade"}, ("stamp", "heade", "header", "log", "did you mean header")),
    ({"delay_s": 11.0}, ("delay_s", "11", "0", "10")),
    ({"delay_s": float("nan")}, ("delay_s", "nan", "0", "10")),
    ({"scale": True}, ("scale", "True", "number|float")),
    ({"scale": "2"}, ("scale", "'2'", "number|float")),
    ({"scale": float("nan")}, ("scale", "nan", "number|float")),
    ({"topic": 5}, ("topic", "5", "text|str")),
    ({"topic": ""}, ("topic", "''", "text|str")),
    ({"field": "a..b"}, ("field", "a..b", "twist.linear.x")),
)
"""What is wrong in a line, and what a message must name: the key, what was given, what is allowed, what was probably meant."""


def checks() -> dict[str, float]:
    """Lines of a topics file that are wrong: how many are refused, and with a message that names all that a user must know."""
    good = {"topic": "/a", "type": "std_msgs/msg/Float64", "field": "data"}

    def ours(line: dict[str, object]) -> None:
        Topics.parse({"torque": {**good, **line}}, "topics.yaml")

    def library(line: dict[str, object]) -> None:
        Line(**line)  # type: ignore[arg-type]

    counts = {}
    for name, check in (("ours", ours), ("attrs", library)):
        refused = named = 0
        for line, wanted in WRONG:
            try:
                check(line)
            except (InputError, TypeError, ValueError) as error:
                refused += 1
                named += all(any(word in str(error) for word in part.split("|")) for part in wanted)
        counts[f"{name}: refused, of {len(WRONG)}"] = float(refused)
        counts[f"{name}: refused with all of it named"] = float(named)
    return counts


OWN_ESTIMATE = "trackres_msgs/msg/Estimate"
OWN_FIELDS = "std_msgs/Header header\nfloat64 feedforward\nfloat64 resistance\nfloat64 std\nuint8 level\nstring[] reasons"


def estimate(messages: int = 2000, repeats: int = 5) -> dict[str, float]:
    """`~/estimate` in the types that it could have: time to fill and its bytes, without ROS, and what a number loses.

    Three reasons hold in each. What is of our own is made whole each time by rosbags, as a DiagnosticArray is; what is published
    is prepared, and made anew where the reasons are others.
    """
    from trackres_ros.node.dds.wire import DdsEstimate, diagnostic_array, typestore
    from trackres_ros.node.transport import Level, Status

    store = typestore()
    if OWN_ESTIMATE not in store.types:
        store.register(get_types_from_msg(OWN_FIELDS, OWN_ESTIMATE))
    reasons = (("LOAD_NOMINAL", Level.WARN), ("AMBIENT_NOMINAL", Level.WARN), ("NO_PUBLISHER", Level.WARN))
    names = ("feedforward_torque_nm", "resistance_torque_nm", "resistance_std_nm")
    torques = [1000.0 + 0.1 * count / 3.0 for count in range(messages)]
    ready, types = DdsEstimate("base_link"), store.types

    def groups() -> list[bytes]:
        return [ready.fill(START_NS, [nm, -nm, 0.1 * nm, 1.0], reasons) for nm in torques]

    def texts() -> list[bytes]:
        found = []
        for nm in torques:
            values = tuple((name, f"{value:.3f}") for name, value in zip(names, (nm, -nm, 0.1 * nm), strict=True))
            status = Status(Level.WARN, "trackres: estimate", " ".join(name for name, _ in reasons), "xgd24d", values)
            found.append(diagnostic_array(START_NS, [status], "base_link"))
        return found

    def own() -> list[bytes]:
        found = []
        for nm in torques:
            header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](*divmod(START_NS, 10**9)), "base_link")
            message = types[OWN_ESTIMATE](header, nm, -nm, 0.1 * nm, 1, [name for name, _ in reasons])
            found.append(bytes(store.serialize_cdr(message, OWN_ESTIMATE)))
        return found

    ways = {"DynamicInterfaceGroupValues": groups, "DiagnosticArray": texts, "a type of our own": own}
    times, last = alternated(ways, repeats), {name: way()[-1] for name, way in ways.items()}
    read = store.deserialize_cdr(last["DiagnosticArray"], "diagnostic_msgs/msg/DiagnosticArray").status[0].values[0].value
    sent = store.deserialize_cdr(last["DynamicInterfaceGroupValues"], "control_msgs/msg/DynamicInterfaceGroupValues")
    found = {f"{name} [us a message]": statistics.median(times[name]) / messages * 1e6 for name in ways}
    found |= {f"{name} [bytes]": float(len(raw)) for name, raw in last.items()}
    found["DiagnosticArray: a torque is off by [Nm]"] = abs(float(read) - torques[-1])
    found["DynamicInterfaceGroupValues: a torque is off by [Nm]"] = abs(sent.interface_values[0].values[0] - torques[-1])
    return found


def page() -> dict[str, float]:
    """What a library that draws in the browser adds to a page, as it is and packed [kB]."""
    from bokeh.resources import Resources

    from trackres_ros.diagnosis.report.interactive import pack

    libraries = {"Bokeh, without widgets": "\n".join(Resources(mode="inline", components=["bokeh"]).js_raw)}
    if importlib.util.find_spec("plotly"):
        from plotly.offline import get_plotlyjs

        libraries["Plotly"] = get_plotlyjs()
    sizes = {}
    for name, text in libraries.items():
        sizes[f"{name} [kB]"] = len(text.encode()) / 1e3
        sizes[f"{name}, packed [kB]"] = len(pack(text)) / 1e3
    return sizes


def export(steps: int = 200_000) -> dict[str, float]:
    """The step in a controller: C translated from its functions, and CasADi run on the same functions."""
    import bench_step

    from trackres_ros.estimator.estimator import Estimator
    from trackres_ros.tools.export.parts import Parts
    from trackres_ros.vehicle import load

    vehicle = load("xgd24d")
    with tempfile.TemporaryDirectory() as folder:
        measured, times = bench_step.measured(vehicle, Path(folder), steps, 0)
    instances = list(Parts(Estimator(vehicle)).translator.instances.values())
    result = {
        "translated: functions": float(len({one.function for one in instances})),
        "translated: a step [us]": 1e6 * float(times[:-1, 0].min()),
        "translated: code [kB]": measured["code [kB]"],
        "translated: time to translate [s]": measured["translated in [s]"],
    }
    if importlib.util.find_spec("casadi"):
        result["CasADi: functions that run on its symbols as they are"] = float(_run_on_symbols(instances))
    return result


def _run_on_symbols(instances: list[Any]) -> int:
    """How many functions of the step run with symbols of CasADi in the place of numbers."""
    found = set()
    for one in instances:
        try:
            one.function(*map(_symbol, one.arguments.values()))
        except Exception:  # whatever a library makes of a branch on a symbol
            continue
        found.add(one.function)
    return len(found)


def _symbol(kind: Any) -> Any:
    """An argument of a kind, of symbols."""
    import casadi

    from trackres_ros.kernels import kinds

    if isinstance(kind, kinds.Const):
        return kind.value
    if isinstance(kind, kinds.Record):
        names = [name for name, _ in kind.fields]
        return namedtuple("given", names)(*(_symbol(part) for _, part in kind.fields))
    if isinstance(kind, kinds.Scalar):
        return casadi.SX.sym("x") if kind == kinds.REAL else 0
    shape = [length if isinstance(length, int) else 64 for length in kind.shape]
    if kind.element != kinds.REAL:
        return np.zeros(shape, dtype=np.int64)
    array = np.empty(int(np.prod(shape)), dtype=object)
    array[:] = [casadi.SX.sym(f"x{i}") for i in range(array.size)]
    return array.reshape(shape)


def rows(steps: int = 200_000, repeats: int = 15) -> dict[str, float]:
    """A low-pass filter on two numbers of an array: called by name and by index, compiled and in plain Python."""
    speed, last = Motion.filtered_speed, Motion.last_speed

    def by_name(numbers: Annotated[Array, (Motion.columns,)], count: int) -> None:
        motion = Motion(numbers)
        for _ in range(count):
            motion.filtered_speed += 0.1 * (motion.last_speed - motion.filtered_speed)
            motion.last_speed += 1e-3

    def by_index(numbers: Annotated[Array, (Motion.columns,)], count: int) -> None:
        for _ in range(count):
            numbers[speed] += 0.1 * (numbers[last] - numbers[speed])
            numbers[last] += 1e-3

    found, plain = {}, {f.__name__: f for f in (by_name, by_index)}
    module = built(plain)
    ways = {"plain Python": plain} | ({} if module is None else {"compiled": {name: getattr(module, name) for name in plain}})
    for way, functions in ways.items():
        count = steps if way == "compiled" else max(1, steps // 100)
        results = [np.zeros(Motion.columns) for _ in functions]
        for function, numbers in zip(functions.values(), results, strict=True):
            function(numbers, count)
        assert np.array_equal(*results)
        runs = {name: partial(function, np.zeros(Motion.columns), count) for name, function in functions.items()}
        times = alternated(runs, repeats)
        found[f"{way}: names over indices"] = median_ratio(times["by_name"], times["by_index"])
    return found


def file_sets(files: int = 20, size: int = 100_000, repeats: int = 20) -> dict[str, float]:
    """Replacement of the files of a report: together, and one by one."""
    with tempfile.TemporaryDirectory() as folder:
        content = bytes(size)

        def one_by_one() -> None:
            for number in range(files):
                write(Path(folder) / f"{number}.svg", content)

        def together() -> None:
            with file_set():
                one_by_one()

        times = alternated({"together": together, "one by one": one_by_one}, repeats)
    found = {f"{way} [ms]": 1e3 * statistics.median(taken) for way, taken in times.items()}
    return {**found, "together over one by one": median_ratio(times["together"], times["one by one"])}


OF_CYTHON = {
    "Array": "cython.double[::1]", "States": "cython.double[:, ::1]", "Mask": "cython.uchar[::1]", "float": "cython.double"
}  # fmt: skip
OF_PYTHRAN = {"Array": "float64[]", "States": "float64[:,:]", "Mask": "bool[]", "float": "float64"}
OF_MYPYC = {**dict.fromkeys(("Array", "States", "Mask"), "np.ndarray"), "float": "float"}
LONGEST_BUILD_S = 120.0
BY_MYPYC = """
from setuptools import setup
from mypyc.build import mypycify
setup(name="by_mypyc", ext_modules=mypycify(["--ignore-missing-imports", "--disable-error-code=type-arg", "by_mypyc.py"]))
"""


def kernel(samples: int = 20_000, rounds: int = 7) -> dict[str, float]:
    """Three kernels, each by our translator, Cython's pure mode, Pythran and mypyc: time over ours, and time to build them."""
    functions = {name: all_entries()[name] for name in ("filter_forward", "mark_corners", "pass")}
    builders = {"Cython": _by_cython, "Pythran": _by_pythran, "mypyc": _by_mypyc}
    found: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder:
        ways: dict[str, Any] = {"ours": lambda _: built(functions)}
        ways |= {
            way: partial(build, functions) for way, build in builders.items() if importlib.util.find_spec(way.replace("P", "p"))
        }
        modules = {}
        for way, build in ways.items():
            (path := Path(folder, way)).mkdir()
            began = time.perf_counter()
            try:
                modules[way] = build(path)
            except subprocess.TimeoutExpired:  # Pythran's C++ took 9 minutes and 5.7 GB
                continue
            found[f"{way}: building [s]"] = time.perf_counter() - began
        for name in functions:
            runs = {way: partial(_function(module, name), *_arguments(name, samples, way)) for way, module in modules.items()}
            runs = {way: run for way, run in runs.items() if _takes(run)}
            times = alternated(runs, rounds)
            found |= {f"{way} over ours: {name}": median_ratio(of, times["ours"]) for way, of in times.items() if way != "ours"}
    return found


def _takes(run: Callable[[], object]) -> bool:
    """Whether a kernel runs as it stands."""
    try:
        run()
    except TypeError:
        return False
    return True


def _function(module: Any, name: str) -> Any:
    return getattr(module, name if hasattr(module, name) else f"{name}_")  # one name is a word of Python


def _arguments(name: str, n: int, way: str) -> list[Any]:
    random = np.random.default_rng(5)
    flags, reals = (random.random(n) < 0.01) | (np.arange(n) == 0), [random.uniform(0.1, 1.0, n) for _ in range(3)]
    kind = np.uint8 if way == "Cython" else np.bool_
    flags, others, marked, rising = flags.view(kind), (~flags).view(kind), np.zeros(n, kind), np.cumsum(reals[0])
    return {
        "filter_forward": [rising, reals[1], others, flags, reals[2], 0.1, np.zeros((n, 5)), marked],
        "mark_corners": [rising, reals[1], 0.2, marked],
        "pass": [*reals[:2], flags, 0.1, 0.3, 0.25, np.zeros((n, 2)), np.zeros((n, 2)), np.zeros(n)],
    }[name]


def _texts(functions: dict[str, Any], types: dict[str, str], annotated: bool = True) -> list[tuple[str, str, str]]:
    """Name, types of the parameters, and source of each function with these types."""
    found = []
    for name, function in functions.items():
        tree = ast.parse(inspect.getsource(function)).body[0]
        tree.decorator_list, tree.name, known = [], f"{name}_" if name == "pass" else name, []
        for argument in tree.args.args:
            hint = "States" if "2" in ast.unparse(argument.annotation) else ast.unparse(argument.annotation)
            known.append(types[hint])
            argument.annotation = ast.parse(types[hint]).body[0].value if annotated else None
        tree.returns = None
        found.append((tree.name, ", ".join(known), ast.unparse(tree)))
    return found


def _constants() -> str:
    names = ("UNKNOWN", "FASTEST", "OUTLIER", "LASTS_S", "BREAKS_S", "MISSED")
    return "import math\nimport numpy as np\n" + "".join(f"{name} = {getattr(speed_smoothing, name)!r}\n" for name in names)


def _built(path: Path, name: str, text: str, *words: str) -> Any:
    (path / f"{name}.py").write_text(text)
    subprocess.run([sys.executable, *words], cwd=path, check=True, capture_output=True, timeout=LONGEST_BUILD_S)
    library = next(one for one in path.rglob("*.so") if one.name.startswith(f"{name}."))
    sys.path.insert(0, str(library.parent))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.pop(0)


def _by_cython(functions: dict[str, Any], path: Path) -> Any:
    head = "# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, infer_types=True\nimport cython\n"
    body = "\n".join(text for *_, text in _texts(functions, OF_CYTHON))
    constants = re.sub(r"^([A-Z_]+) = (.*)$", r"\1 = cython.declare(cython.double, \2)", _constants(), flags=re.MULTILINE)
    constants = constants.replace(
        "import math", "from cython.cimports.libc import math\nINF = cython.declare(cython.double, np.inf)"
    )
    constants, body = constants.replace("np.inf)", "float('inf'))"), body.replace("np.inf", "INF")
    return _built(path, "by_cython", head + constants + body, "-m", "Cython.Build.Cythonize", "-i", "-q", "by_cython.py")


def _by_pythran(functions: dict[str, Any], path: Path) -> Any:
    texts = _texts(functions, OF_PYTHRAN, annotated=False)
    exports = "".join(f"#pythran export {name}({types})\n" for name, types, _ in texts)
    return _built(
        path, "by_pythran", exports + _constants() + "\n".join(text for *_, text in texts), "-m", "pythran.run", "by_pythran.py"
    )


def _by_mypyc(functions: dict[str, Any], path: Path) -> Any:
    (path / "setup.py").write_text(BY_MYPYC)
    body = "\n".join(text for *_, text in _texts(functions, OF_MYPYC))
    return _built(path, "by_mypyc", _constants() + body, "setup.py", "build_ext", "--inplace")


DECISIONS: dict[str, Callable[..., dict[str, float]]] = {
    "cdr": cdr, "mcap": mcap, "noise": noise, "checks": checks, "estimate": estimate, "page": page, "export": export,
    "rows": rows, "kernel": kernel, "file_sets": file_sets,
}  # fmt: skip

if __name__ == "__main__":
    for chosen in sys.argv[1:] or DECISIONS:
        for what, value in DECISIONS[chosen]().items():
            print(f"{chosen}: {what:65} {value:10.3g}", flush=True)
