"""Which of a file's height channels to read: the only one, or the one that the user names."""

from __future__ import annotations

from collections.abc import Sequence

from dlwpredict.errors import InputError


def chosen_channel(titles: Sequence[str], channel: str | None) -> int:
    """Return the index of the channel to read.

    Parameters
    ----------
    titles : sequence of str
        Titles of the height channels in the file's order.
    channel : str, optional
        Title, or number counted from 1; needed where there are several.

    Raises
    ------
    InputError
        No height channel, several and none named, or a name that fits none or several.

    Examples
    --------
    >>> chosen_channel(["forward", "backward"], "backward"), chosen_channel(["forward", "backward"], "1")
    (1, 0)
    """
    if not titles:
        raise InputError("no channel of heights", key="channels", allowed="at least one in a unit of length")
    listed = ", ".join(f"{number} {title}" for number, title in enumerate(titles, 1))
    if channel is None:
        if len(titles) > 1:
            raise InputError(f"{len(titles)} channels ({listed})", key="channels", allowed="use convert --channel")
        return 0
    if titles.count(channel) == 1:
        return titles.index(channel)
    if channel.isdecimal() and 1 <= int(channel) <= len(titles):
        return int(channel) - 1
    raise InputError(f"found {channel}", key="--channel", allowed=f"allowed: {listed}")
