"""Check a refusal: an error of this package, one printable line, and words that name what is wrong."""

import pytest

from softdeca.lhm import InputError


def refused(words, call, *arguments, error=InputError, **options) -> str:
    """Assert that a call is refused in one line that matches a pattern; that line."""
    with pytest.raises(error, match=words) as raised:
        call(*arguments, **options)
    said = str(raised.value)
    assert said.isprintable(), said[:600]
    return said
