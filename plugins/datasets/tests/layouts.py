"""Writers of a recording into the layout of every data set, by the type of scene that reads it."""

from collections.abc import Callable
from pathlib import Path

import commonroad_writer
import dair_writer
import kitti_writer
import opv2v_writer
import rosbag_writer
import sumo_writer
import tumtraf_writer
import urbaning_writer

from mast_zenoh.scenes.recording import Recording

#: Writers of a recording; they return the scene's path.
TWINS: dict[str, Callable[[Path, Recording], Path]] = {
    "OPV2VScene": lambda folder, source: opv2v_writer.write_opv2v(source, folder),
    "V2XRealScene": lambda folder, source: opv2v_writer.write_v2xreal(source, folder),
    "MultiV2XScene": lambda folder, source: opv2v_writer.write_multiv2x(source, folder),
    "V2V4RealScene": lambda folder, source: opv2v_writer.write_v2v4real(source, folder),
    "DAIRScene": lambda folder, source: dair_writer.write_spd(folder, source, len(source)),
    "RCooperScene": lambda folder, source: dair_writer.write_rcooper(folder, source, len(source)),
    "RosBag": lambda folder, source: rosbag_writer.write_recording(folder, source),
    "KittiTracking": lambda folder, source: kitti_writer.write_kitti(source, folder),
    "CommonRoadScenario": lambda folder, source: commonroad_writer.write_commonroad(source, folder.with_suffix(".xml")),
    "SumoTrace": lambda folder, source: sumo_writer.write_sumo(source, folder),
    "TUMTrafV2X": lambda folder, source: tumtraf_writer.write(folder, source) and folder,
    "UrbanIngV2X": lambda folder, source: urbaning_writer.write(folder, source) and folder,
}
