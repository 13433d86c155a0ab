"""What every message about a user's file has in common."""

import re

import pytest

JARGON = re.compile(
    r"pydantic|Input should|Field required|Extra inputs|type=|input_value|https?://|validation "
    r"error|Value error|\bNone\b|\bdict\b|\btuple\b|\bfloat\b|Traceback|yaml\.|<class"
)


@pytest.fixture(scope="session")
def assert_in_house_style():
    """Asserts a path line, then indented problems, without the words of the libraries below."""

    def check(text: str) -> None:
        first, *problems = text.split("\n")
        assert not first.startswith(" ")
        assert problems
        assert not JARGON.search(text), text
        assert all(len(line) < 400 for line in text.split("\n"))

    return check


@pytest.fixture
def message(assert_in_house_style):
    """message(load, path): the text of the ConfigError that loading raises, in house style."""
    from pipeline.config.messages import ConfigError

    def catch(load, *arguments) -> str:
        with pytest.raises(ConfigError) as caught:
            load(*arguments)
        assert_in_house_style(str(caught.value))
        return str(caught.value)

    return catch
