"""Cars and poles with sensors at different times and rates."""

from baseline import scenario as baseline


def scenario(
    car_rate_hz=10.0,
    car_phase_s=0.03,
    pole_rate_hz=5.0,
    pole_phase_s=0.07,
    narrow_agent="infra_1",
    narrow_rate_hz=10.0,
    measurement_times=True,
    scene_index=0,
    n_infrastructure=4,
    n_mobile=1,
):
    """A baseline run in which no two kinds of sensors measure at the same time.

    car_…, pole_…: measurements per second, and time of the first one;
    narrow_agent: has a second, narrow sensor with a range of 150 m; narrow_rate_hz: its measurements per second;
    measurement_times: False: agents treat a measurement as made at the time of the frame in which it arrives;
    scene_index: number of a generated junction;
    n_infrastructure, n_mobile: numbers of poles, and of cars besides the ego, with sensors.
    """
    car = dict(type="Lidar", rate_hz=car_rate_hz, phase_s=car_phase_s)
    pole = dict(type="Lidar", rate_hz=pole_rate_hz, phase_s=pole_phase_s)
    narrow = dict(
        type="Radar", name="narrow", rate_hz=narrow_rate_hz, azimuth_deg=(-10.0, 10.0), pitch_deg=-10.0, range_m=150.0
    )
    scene = dict(
        type="Intersection",
        scene_index=scene_index,
        n_infrastructure=n_infrastructure,
        n_mobile=n_mobile,
        sensors={"*": [car], "infra_*": [pole], narrow_agent: [pole, narrow]},
    )
    unequal = baseline(scene)
    agents = {name: agent | dict(measurement_times=measurement_times) for name, agent in unequal["agents"].items()}
    return unequal | dict(name="rates", agents=agents)
