"""Pages of studies, from templates of their own that extend those of the package."""

from typing import Any

from protochain.results.page import templates


def render(template: str, /, **variables: Any) -> str:
    """Fill a template of a study; what comes from files is escaped."""
    return templates("bench").get_template(template).render(**variables)
