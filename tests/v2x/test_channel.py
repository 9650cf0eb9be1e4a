"""Airtime, busy ratio of the channel, and which transmissions arrive."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.streams import stream
from mast_zenoh.v2x.channel import BACKOFF_SLOTS, OfdmTiming, RadioChannel, Transmissions, arrivals, clear_probability

#: Bytes of a CPM by number of objects, measured with TS 103 324 v2.1.1.
CPM_BYTES = {10: 360, 20: 683, 30: 1005}
TARGET = 0.68


def line(*x: float) -> Floats:
    """Stations on a line, at x m."""
    return np.array([[station, 0.0] for station in x]).reshape(-1, 2)


def on_air(*parts: tuple[int, int, int]) -> Transmissions:
    """Transmissions of (sender, start in ms, airtime in ms)."""
    sender, start, airtime = (np.array(column, np.int64) for column in zip(*parts, strict=True))
    return Transmissions(sender, start * 1_000_000, airtime * 1_000_000)


def test_airtime_is_a_preamble_and_whole_symbols() -> None:
    bare = OfdmTiming(overhead_bytes=0)
    # 16 + 8 * 100 + 6 = 822 bits in 18 symbols of 48 bits (17 hold 816).
    assert bare.airtime_ns(np.array([100]))[0] == 40_000 + 18 * 8_000
    assert OfdmTiming(overhead_bytes=100).airtime_ns(np.array([0]))[0] == 40_000 + 18 * 8_000
    assert OfdmTiming(overhead_bytes=0, bit_rate_mbps=27.0).airtime_ns(np.array([100]))[0] == 40_000 + 4 * 8_000


@given(size=st.integers(0, 2000))
def test_another_byte_never_shortens_a_transmission_and_adds_at_most_a_symbol(size: int) -> None:
    shorter, longer = OfdmTiming().airtime_ns(np.array([size, size + 1]))
    assert longer - shorter in (0, 8_000)


@pytest.mark.parametrize(("objects", "stations"), [(10, 88), (20, 56), (30, 41)])
def test_at_10_hz_the_target_load_is_reached_by_a_known_number_of_stations(objects: int, stations: int) -> None:
    """As computed by hand from the sizes of CPMs, with a quiet time of 58 µs before each."""
    seconds = OfdmTiming().airtime_ns(np.array([CPM_BYTES[objects]]))[0] / 1e9 + 58e-6
    assert int(TARGET / (10.0 * seconds)) == stations


def test_power_falls_with_distance_and_twice_as_fast_beyond_the_breakpoint() -> None:
    channel = RadioChannel(near_exponent=2.0, far_exponent=4.0, breakpoint_m=100.0)
    power = channel.mean_power_dbm(np.array([0.1, 1.0, 10.0, 100.0, 1000.0]))
    assert power - power[1] == pytest.approx([0.0, 0.0, -20.0, -40.0, -80.0])


@pytest.mark.parametrize("busy_dbm", [-100.0, -85.0, -60.0])
def test_the_channel_is_busy_up_to_the_distance_at_which_the_mean_power_is_the_threshold(busy_dbm: float) -> None:
    channel = RadioChannel(busy_dbm=busy_dbm)
    assert channel.mean_power_dbm(np.array(channel.sensing_range_m)) == pytest.approx(busy_dbm)


def test_no_station_is_heard_below_the_threshold_at_1_m() -> None:
    channel = RadioChannel(busy_dbm=0.0)
    assert channel.sensing_range_m == 0.0
    assert channel.audible(line(0.0, 1.0)).tolist() == [[True, False], [False, True]]


@pytest.mark.parametrize("fading_shape", [1, 2, 3, 5])
def test_decoding_agrees_with_draws_of_nakagami_fading(fading_shape: int) -> None:
    channel = RadioChannel(fading_shape=fading_shape)
    distance = np.array([50.0, 150.0, 250.0, 400.0])
    rng = np.random.default_rng(0)
    mean_mw = 10.0 ** (channel.mean_power_dbm(distance) / 10.0)
    power = rng.gamma(fading_shape, mean_mw / fading_shape, (40_000, 4))
    decoded = (10.0 * np.log10(power) >= channel.sensitivity_dbm).mean(axis=0)
    assert channel.decoding_probability(distance) == pytest.approx(decoded, abs=0.01)


def test_a_station_is_busy_with_all_transmissions_in_its_range_including_its_own() -> None:
    channel = RadioChannel()
    far = channel.sensing_range_m
    position = line(0.0, 0.9 * far, 1.8 * far)
    busy = channel.busy_ratio(position, on_air((0, 0, 10), (1, 20, 20), (2, 50, 30)), now_ns=100_000_000)
    assert busy == pytest.approx([0.3, 0.6, 0.5])


def test_only_the_part_of_a_transmission_within_the_window_counts() -> None:
    sent = on_air((0, 0, 10), (0, 195, 10), (0, 98, 4), (0, 300, 10))
    assert sent.total_ns(200_000_000, 1, 100_000_000).tolist() == [5_000_000 + 2_000_000]


def test_transmissions_of_one_frame_load_the_time_between_two_frames() -> None:
    """In frames of 500 ms, what begins with a frame ends long before the last 100 ms of it."""
    sent, position, now = on_air((0, 0, 10)), line(0.0, 100.0), 500_000_000
    assert RadioChannel().busy_ratio(position, sent, now).tolist() == [0.0, 0.0]
    assert RadioChannel().busy_ratio(position, sent, now, window_ns=now) == pytest.approx([0.02, 0.02])
    lossless, loaded_one = (RadioChannel().reception(position, sent, now, window_ns)[1, 0] for window_ns in (None, now))
    assert loaded_one < lossless


def clear(audible: Bools, load: Floats, hidden_terminals: bool = True) -> Floats:
    """Probabilities that nothing collides, for shares of time in which stations transmit."""
    return clear_probability(audible, np.rint(load * 1e8).astype(np.int64), 100_000_000, hidden_terminals)


#: Stations 0 and 2 do not hear each other; station 1 hears both.
HIDDEN: Bools = np.array([[1, 1, 0], [1, 1, 1], [0, 1, 1]], bool)


def test_a_hidden_terminal_collides_as_in_pure_aloha() -> None:
    load = np.array([0.0, 0.0, 0.2])
    assert clear(HIDDEN, load)[0, 1] == pytest.approx(np.exp(-2.0 * 0.2))
    assert clear(HIDDEN, load, hidden_terminals=False)[0, 1] == 1.0
    assert clear(HIDDEN, load)[2, 1] == 1.0, "a station does not collide with itself"


def test_hidden_terminals_collide_as_in_a_simulation_of_their_start_times() -> None:
    rng = np.random.default_rng(1)
    airtime, rate, trials = 1e-3, 300.0, 20_000  # the load of the hidden station is 0.3
    others = rng.poisson(rate * 2.0 * airtime, trials)  # its starts within one airtime before or after
    assert clear(HIDDEN, np.array([0.0, 0.0, 0.3]))[0, 1] == pytest.approx((others == 0).mean(), abs=0.01)


@pytest.mark.parametrize(("load", "tolerance"), [(0.5, 0.01), (1.3, 0.1)])
def test_stations_that_hear_each_other_collide_as_in_a_simulation_of_backoff_and_a_queue(load, tolerance):
    """Messages arrive at random, wait while the channel is busy, and draw a slot; the slots are short."""
    rng = np.random.default_rng(2)
    stations, messages = 400, 20_000
    audible = np.ones((stations, stations), bool)
    expected = clear(audible, np.full(stations, load / stations))[0, 1]
    arrival = np.cumsum(rng.exponential(1.0 / load, messages))  # in airtimes
    now, served, collided, slot_s = 0.0, 0, 0, 13e-6 / 1.3e-3
    waiting: list[int] = []  # slots left of each
    while served < messages or waiting:
        if not waiting:
            now = max(now, float(arrival[served])) if served < messages else now
            if arrival[served] >= now:  # the channel is idle: it is sent at once
                served += 1
                ends = now + 1.0
        else:
            least = min(waiting)
            collided += waiting.count(least) if waiting.count(least) > 1 else 0
            waiting = [left - least for left in waiting if left > least]
            ends = now + least * slot_s + 1.0
        while served < messages and arrival[served] < ends:
            waiting.append(int(rng.integers(BACKOFF_SLOTS)))
            served += 1
        now = ends
    assert 1.0 - collided / messages == pytest.approx(expected, abs=tolerance)


def loaded(load: list[float]) -> Transmissions:
    """One transmission of each station, as a share of the last 100 ms before 100 ms."""
    airtime = np.rint(np.array(load) * 1e8).astype(np.int64)
    return Transmissions(np.arange(len(load)), 100_000_000 - airtime, airtime)


def test_an_unheard_and_distant_load_does_not_matter() -> None:
    position = line(0.0, 100.0, 100_000.0)
    with_load, without = (
        RadioChannel().reception(position, loaded([0.1, 0.1, load]), 100_000_000) for load in (0.5, 0.0)
    )
    assert with_load[0, 1] == without[0, 1]


@given(x=st.lists(st.floats(0.0, 2000.0), min_size=2, max_size=8), load=st.floats(0.0, 0.1), more=st.floats(0.0, 0.1))
def test_more_load_never_helps(x: list[float], load: float, more: float) -> None:
    position, channel = line(*x), RadioChannel()
    before, after = (
        channel.reception(position, loaded([share] * len(x)), 100_000_000) for share in (load, load + more)
    )
    assert (after <= before + 1e-12).all()
    assert ((before >= 0.0) & (before <= 1.0)).all()
    assert not np.diagonal(before).any()


@given(order=st.permutations(range(6)), seed=st.integers(0, 50))
def test_the_channel_is_the_same_in_any_order_of_stations(order: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    position, channel, rows = rng.uniform(0.0, 600.0, (6, 2)), RadioChannel(), np.array(order)
    sent = loaded(rng.uniform(0.0, 0.2, 6).tolist())
    moved = Transmissions(np.argsort(rows)[sent.sender], sent.start_ns, sent.airtime_ns)
    now = 100_000_000
    assert (channel.busy_ratio(position[rows], moved, now) == channel.busy_ratio(position, sent, now)[rows]).all()
    plain = channel.reception(position, sent, now)
    assert (channel.reception(position[rows], moved, now) == plain[np.ix_(rows, rows)]).all()


def arrived_at(chance: Floats, sender: Ints, seed: int = 0) -> Bools:
    """Arrivals, with a named stream for each sender."""
    return arrivals(chance, sender, lambda station: stream(seed, "channel", 7, station))


@given(order=st.permutations(range(5)), seed=st.integers(0, 50))
def test_arrivals_do_not_depend_on_the_order_of_senders(order: list[int], seed: int) -> None:
    chance = np.full((5, 5), 0.5)
    plain = arrived_at(chance, np.arange(5), seed)
    assert (arrived_at(chance, np.array(order), seed) == plain[order]).all()


def test_arrivals_do_not_depend_on_who_else_sends_and_improve_with_the_chance() -> None:
    chance = np.full((4, 4), 0.5)
    together, alone = arrived_at(chance, np.array([0, 1, 2, 2])), arrived_at(chance, np.array([2, 2]))
    assert (together[2:] == alone).all()
    assert (arrived_at(chance + 0.2, np.array([2, 2])) >= alone).all(), "common random numbers"
    assert (alone[0] != alone[1]).any(), "each transmission of a sender has its own draws"


def test_transmissions_arrive_as_often_as_their_chance() -> None:
    chance = np.array([[0.0, 0.25, 0.9]] * 3)
    share = arrived_at(chance, np.zeros(4000, np.int64)).mean(axis=0)
    assert share == pytest.approx([0.0, 0.25, 0.9], abs=0.03)
