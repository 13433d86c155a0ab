"""What a user is told of bad files."""

import pytest


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
