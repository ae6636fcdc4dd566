# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Every source file says its licence at the top; `tools/licence-headers --write` adds it to a new one."""

import runpy
import subprocess
import sys

import pytest


def test_every_source_file_says_its_licence(repository):
    command = [sys.executable, repository / "tools" / "licence-headers", "--check"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout == ""
    assert done.returncode == 0


@pytest.mark.parametrize(
    ("text", "begins"),
    [
        ('"""Something."""\n', "{header}\n"),
        ("", "{header}"),
        ("#!/usr/bin/env python3\npass\n", "#!/usr/bin/env python3\n{header}\npass"),
    ],
)
def test_the_header_is_added_once_and_an_interpreter_stays_first(repository, text, begins):
    tool = runpy.run_path(str(repository / "tools" / "licence-headers"))
    once = tool["headed"](text)
    assert once.startswith(begins.format(header=tool["HEADER"]))
    assert once.endswith(text.splitlines()[-1] + "\n" if text else tool["HEADER"])
    assert tool["headed"](once) == once
