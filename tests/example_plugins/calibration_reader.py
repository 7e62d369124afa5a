"""A reader of calibration files in a plugin file: one line of CSV with translation and quaternion."""

import p2o
from p2o.reading import Calibration, CalibrationReader, Reading, Source, read_pose

HEADER = "acme x_m,y_m,z_m,qx,qy,qz,qw"


class AcmeReading(Reading):
    """Options of the reader."""

    scale: float = p2o.field(1.0, gt=0, help="Length of one unit of the file in metres.")


class AcmeReader(CalibrationReader):
    """Reads camera_from_lidar of one line below the header."""

    rank = 20

    def __init__(self, options: AcmeReading) -> None:
        self.options = options

    def recognises(self, source: Source) -> bool:
        """Return whether the file begins with the header."""
        return source.text.startswith(HEADER)

    def read(self, source: Source) -> Calibration:
        """Return the extrinsic; raises InputError that names the file."""
        values = source.text.removeprefix(HEADER).strip().split(",")
        if len(values) != 7:
            raise p2o.InputError("this is not a pose", where=source.path, expected="7 numbers", got=len(values))
        pose = {"translation_m": values[:3], "rotation_xyzw": values[3:]}
        unscaled, remarks = read_pose("camera_from_lidar", pose, source.path)
        scaled = p2o.se3.make(unscaled[:3, :3], self.options.scale * unscaled[:3, 3])
        return Calibration(camera_from_lidar=scaled, remarks=remarks)

    def example(self) -> bytes:
        """Return a small file of this format."""
        return f"{HEADER}\n0.1,-0.2,-0.3,0.5,-0.5,0.5,0.5\n".encode()


@p2o.hookimpl
def p2o_calibration_readers():
    """Offer the reader."""
    yield p2o.Method(name="acme", build=AcmeReader, options=AcmeReading, summary="A pose as CSV.")
