"""The one exception that means: what was given cannot be used, and this is what to do."""

from __future__ import annotations


class InputError(ValueError):
    """Bad input from outside: a file, an option, a topic. Its text is one line that a user can act on."""

    def __init__(self, where: str, given: object, allowed: str, remedy: str = "") -> None:
        self.where, self.given, self.allowed, self.remedy = where, given, allowed, remedy
        text = f"{where}: given {given!r}; allowed: {allowed}"
        super().__init__(f"{text}; {remedy}" if remedy else text)

    def as_dict(self) -> dict[str, str]:
        """Its parts for programs."""
        return {"where": self.where, "given": str(self.given), "allowed": self.allowed, "remedy": self.remedy}

    def __reduce__(self) -> tuple[object, ...]:
        """So that it crosses from one process to another as what it is."""
        return InputError, (self.where, self.given, self.allowed, self.remedy)


class MissingExtraError(InputError):
    """An optional library is needed and not installed."""

    def __init__(self, feature: str, module: str, extra: str, remark: str = "") -> None:
        super().__init__(
            feature,
            f"no Python module {module}",
            f"an installed {module}",
            f"install it with: pip install {module} (or this package with its extra [{extra}]){remark and f'; {remark}'}",
        )
