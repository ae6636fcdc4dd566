"""`trackres diagnose` and `trackres effects`."""

from __future__ import annotations

import json
from pathlib import Path

import click

from trackres_ros.cli.common import emit, json_option, method_options, output_folder, surroundings_option, vehicle_option
from trackres_ros.errors import InputError, MissingExtraError


@click.command("diagnose")
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path))
@vehicle_option
@surroundings_option
@click.option(
    "--topics", "topics_file", type=click.Path(path_type=Path), metavar="T.yaml", help="Which topic or column feeds which role."
)
@click.option(
    "--hide", multiple=True, metavar="CHANNEL", help="Leave a channel unread, such as grade or yaw_rate; may be repeated."
)
@click.option(
    "--holdout",
    metavar="N|NAMES",
    help="How many of the last recordings or laps to hold out, or names of recordings with commas.",
)
@method_options
@click.option("--seed", type=int, default=1, show_default=True, help="Of all that is drawn at random.")
@click.option("--quick", is_flag=True, help="Fewer draws for thresholds.")
@click.option(
    "--keep-suspected", is_flag=True, help="Write effects too that fit and that laps not used for fitting do not confirm."
)
@click.option(
    "--effects",
    "effects_dir",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Folder with effects of your own, a Python file each.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    required=True,
    metavar="DIR",
    help="Folder for the report; made if need be.",
)
@json_option
def diagnose_command(
    recordings: tuple[Path, ...],
    vehicle: str,
    surroundings_file: Path | None,
    topics_file: Path | None,
    hide: tuple[str, ...],
    holdout: str | None,
    method: str | None,
    thermal: str | None,
    seed: int,
    quick: bool,
    keep_suspected: bool,
    effects_dir: Path | None,
    output: Path,
    as_json: bool,
) -> None:
    """Where recordings and simulation part, which physics is missing, and a vehicle file that has it.

    Each RECORDING with a measured torque is a session: a rosbag2 folder, .mcap, .db3, .bag, .csv, .csv.gz or .parquet.

    \b
    trackres diagnose day1.mcap day2.mcap --vehicle xgd24d --topics topics.yaml -o report

    Writes report.json, report.html, vehicle.yaml and pictures, and says in one sentence what it comes to. What is of the site,
    the weather or the ground goes to surroundings.yaml instead; what is a sensor's is printed as lines for the topics file.
    Ends with exit code 0 whatever the verdict.
    """
    from trackres_ros.diagnosis import diagnose, load_base, read_recordings
    from trackres_ros.diagnosis.report import report
    from trackres_ros.recording import ROLES, base_role
    from trackres_ros.sources import open_source
    from trackres_ros.topics import Topics, nearest

    for channel in hide:
        if base_role(channel) not in ROLES:
            raise InputError("--hide", channel, ", ".join(ROLES), nearest(channel, ROLES))
    output_folder(output)
    held = None if holdout is None else int(holdout) if holdout.isdecimal() else [name.strip() for name in holdout.split(",")]
    topics = Topics.load(topics_file) if topics_file else None
    loaded = load_base(vehicle, method, thermal, topics, surroundings_file)
    read = read_recordings(recordings, topics)
    found = diagnose(
        read, loaded, hide, held, seed, quick, effects_dir, keep_suspected, said=lambda stage: click.echo(f"  {stage}", err=True)
    )
    content = report(found, recordings, open_source([recordings[0]], topics).bindings)
    output.mkdir(parents=True, exist_ok=True)
    (output / "report.json").write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    text = f"{found.verdict.sentence}\nWritten by trackres diagnose from {', '.join(path.name for path in recordings)}."
    files = loaded.base.write(output / "vehicle.yaml", found.kept, text)
    written = ["report.json", *(path.name for path in files)]
    try:
        from trackres_ros.report.page import write_page
        from trackres_ros.report.pictures import draw_all

        pictures = draw_all(found, output)
        write_page(output / "report.html", content, pictures, f"Diagnosis of {loaded.title}")
        written += ["report.html", *(p.path.name for p in pictures)]
    except MissingExtraError as error:
        click.echo(f"trackres: no page: {error}", err=True)
    why = found.kept.text
    lines = [found.verdict.sentence, f"{why[0].upper()}{why[1:]}.", *content["to_do"], *content["topics_lines"].values()]
    emit(content, as_json, lambda: "\n".join([*lines, f"{output}: {', '.join(written)}"]))


@click.command("effects")
@click.option("--effects", "effects_dir", type=click.Path(path_type=Path), metavar="DIR", help="Folder with effects of your own.")
@json_option
def effects_command(effects_dir: Path | None, as_json: bool) -> None:
    """The catalogue of left-out effects: what each does, and its parameters."""
    from trackres_ros.effects import catalogue

    listed = [effect.describe() for effect in catalogue(effects_dir).values()]

    def text() -> str:
        lines = []
        for effect in listed:
            of = f"{effect['acts_on']}, of the {effect['belongs_to']}"
            lines.append(f"{effect['name']} ({of}): {effect['text']}; needs {', '.join(effect['needs'])}")
            lines += [
                f"    {name} {q['low']:g} to {q['high']:g} {q['unit']}: {q['text']}" for name, q in effect["parameters"].items()
            ]
        return "\n".join(lines)

    emit({"effects": listed}, as_json, text)
