# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs `trackres reproduce`: draws the paper's figures."""

from pathlib import Path
from typing import Any

import click

from trackres_ros import InputError
from trackres_ros.cli import options
from trackres_ros.cli.common import emit, needs, output_folder, progress
from trackres_ros.cli.partial_output import watch


@click.command("reproduce")
@click.option("-o", "--output", type=options.FOLDER, required=True, help="Folder for pictures, tables and the page.")
@click.option(
    "--page", type=click.Path(path_type=Path, dir_okay=False), help="Write the page here too, with links into the folder."
)
@options.json
def reproduce_command(output: Path, page: Path | None, as_json: bool) -> None:
    """Reproduce the paper's Figures 6, 10, 11, 16, 24, 25, 26 and three tests, as PNG and CSV, with a page of checks.

    \b
    trackres reproduce -o figures
    """
    from trackres_ros.evaluation.reproduce import reproduce

    needs("pictures", "plots", "matplotlib")
    if page is not None and not page.parent.is_dir():
        raise InputError("--page", str(page), "a file in a folder that exists")
    output_folder(output)
    watch(page)
    with progress("figures", 1.0) as advance:
        done = 0.0

        def report(_: str, share: float) -> None:
            nonlocal done
            advance(share - done)
            done = share

        summary: dict[str, Any] = reproduce(output, report, page=page)
    emit(summary, as_json, lambda: f"Figures, tables and index.md are in {output}")
