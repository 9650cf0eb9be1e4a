"""Episodes of displaced objects in view of honest agents."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.study.defences.drift import Episode, ViewerRange, episodes

PERIOD_S = 0.1
TWO, TWO_OR_MORE, ANY = ViewerRange(2, 2), ViewerRange(2, None), ViewerRange(1, None)


def of(
    viewers: str, suspended_s: float | None = None, viewer_range: ViewerRange = TWO, start_s: float = 4.0
) -> list[Episode]:
    """Episodes of one track; viewers: the number in each frame, "-" where it is not displaced."""
    frames = [(index, int(each)) for index, each in enumerate(viewers) if each != "-"]
    times = [start_s + index * PERIOD_S for index, _ in frames]
    offset = [0.1 * (index + 1) for index, _ in frames]
    return episodes(times, [7] * len(frames), [count for _, count in frames], offset, suspended_s, viewer_range)


def test_an_episode_ends_with_the_suspension() -> None:
    (episode,) = of("2" * 21, suspended_s=5.5)
    assert (episode.length_s, episode.watched_s, episode.detected) == (2.0, 1.5, True)
    assert episode.offset_m == pytest.approx(1.6)
    assert episode.speed_up == pytest.approx(2.0 ** (1.0 / 3.0))


def test_without_a_suspension_it_is_censored_at_its_end() -> None:
    (episode,) = of("2" * 21)
    assert (episode.length_s, episode.watched_s, episode.detected) == (2.0, 2.0, False)


def test_a_suspension_after_its_end_is_no_detection() -> None:
    (episode,) = of("2" * 21, suspended_s=9.0)
    assert (episode.watched_s, episode.detected) == (2.0, False)


def test_what_is_displaced_after_the_suspension_is_left_out() -> None:
    assert of("2" * 21, suspended_s=4.0) == []
    assert of("----------" + "2" * 11, suspended_s=4.5) == []


def test_another_number_of_viewers_ends_it_after_half_a_second() -> None:
    assert of("2" * 11 + "1111" + "2" * 6)[0].length_s == 2.0
    assert of("2" * 11 + "11111" + "2" * 6)[0].length_s == 1.0
    assert of("2" * 11 + "-----" + "2" * 6)[0].length_s == 1.0


def test_a_clock_starts_only_where_nothing_was_known_before() -> None:
    assert of("3333" + "2" * 11) == [], "three agents saw it before"
    assert of("1111" + "2" * 11)[0].length_s == 1.0, "one witness decides nothing"
    assert of("0000" + "1" * 11, viewer_range=ViewerRange(1, 1))[0].length_s == 1.0
    assert of("2222" + "1" * 11, viewer_range=ViewerRange(1, 1)) == []


def test_an_open_range_goes_on_while_viewers_change() -> None:
    (episode,) = of("22223334441112222", viewer_range=TWO_OR_MORE)
    assert episode.length_s == 1.6
    (episode,) = of("1" * 10 + "8" * 10, viewer_range=ANY)
    assert episode.speed_up == pytest.approx(1.5), "one witness, then eight: mean of 1 and 2"


def test_each_track_has_its_own_clock() -> None:
    times = [4.0, 4.1, 4.2, 5.0, 5.1, 5.2]
    result = episodes(times, [1, 1, 1, 2, 2, 2], [2] * 6, [0.5] * 6, 5.1, TWO)
    assert [(each.watched_s, each.detected) for each in result] == [(0.2, False), (0.1, True)]


def test_only_what_lasts_long_enough_is_judged() -> None:
    (short,) = of("2" * 100)
    (long,) = of("2" * 101, suspended_s=14.0)
    assert not short.judged_within(10.0)
    assert long.judged_within(10.0)
    assert long.detected_within(10.0)
    assert not long.detected_within(9.9)


def test_nothing_displaced_has_no_episodes() -> None:
    assert episodes([], [], [], [], None, ANY) == []


@given(st.text("01234-", min_size=1, max_size=60), st.integers(0, 70))
def test_a_suspension_changes_what_is_watched_and_never_how_long_it_lasts(viewers: str, after: int) -> None:
    suspended_s = 4.0 + after * PERIOD_S
    whole = of(viewers, None, ANY)
    watched = of(viewers, suspended_s, ANY)
    assert [each.length_s for each in watched] in ([], [each.length_s for each in whole])
    for each in watched:
        assert 0.0 <= each.watched_s <= each.length_s + 1e-9
        assert each.detected or each.watched_s == each.length_s
        assert np.isfinite(each.speed_up)


@given(st.permutations(list(range(12))))
def test_the_order_of_rows_does_not_matter(order: list[int]) -> None:
    times = np.tile(4.0 + PERIOD_S * np.arange(6), 2)
    track, viewers = np.repeat([3, 5], 6), np.array([2, 2, 3, 2, 2, 1, 1, 2, 2, 2, 2, 2])
    offset = np.linspace(0.1, 1.2, 12)
    rows = np.array(order)
    shuffled = episodes(times[rows], track[rows], viewers[rows], offset[rows], 4.4, TWO_OR_MORE)
    expected = episodes(times, track, viewers, offset, 4.4, TWO_OR_MORE)
    assert sorted(shuffled, key=lambda each: each.length_s) == sorted(expected, key=lambda each: each.length_s)
