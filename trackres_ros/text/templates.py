# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Templates of pages by jinja2: inserted values are escaped, and a missing value is an error."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from trackres_ros.errors import MissingExtraError

if TYPE_CHECKING:
    from jinja2 import Environment


def templates(package: str, page: str, extra: str, **filters: Callable[..., Any]) -> Environment:
    """The templates in the folder of a package.

    `page`, `extra`: page that needs them, and the extra that installs jinja2; `filters`: by name. Raises MissingExtraError
    without jinja2.
    """
    try:
        from jinja2 import Environment, PackageLoader, StrictUndefined
    except ImportError:
        raise MissingExtraError(page, "jinja2", extra) from None
    environment = Environment(loader=PackageLoader(package, "."), autoescape=True, undefined=StrictUndefined)
    environment.filters.update(filters)
    return environment
