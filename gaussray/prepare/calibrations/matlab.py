"""MATLAB's stereoParams.mat, which only MATLAB reads: how to write its numbers to a .json."""

from pathlib import Path
from typing import NoReturn

from gaussray.prepare.errors import PrepareError


# Lines of MATLAB (R2021b or later, with the toolbox that calibrates) that write what is read. The
# function subtracts 1 from principal points, which MATLAB counts from 1.
MATLAB_SNIPPET = """\
    [K1,d1,K2,d2,R,t,s] = stereoParametersToOpenCV(stereoParams);
    c.left = struct('K',K1,'dist',d1,'size',s([2 1]),'R',eye(3),'t',[0 0 0]);
    c.right = struct('K',K2,'dist',d2,'size',s([2 1]),'R',R,'t',t);
    f = fopen('stereo.json','w'); fprintf(f,'%s',jsonencode(c)); fclose(f);"""


def refuse_matlab(path: Path) -> NoReturn:
    """Refuse a .mat file, in which the objects of MATLAB's calibrators are opaque.

    Raises:
        PrepareError: Always, with the lines of MATLAB that export the calibration.
    """
    raise PrepareError(
        f"{path}: must not be a .mat file: MATLAB's calibrations are objects in it that only "
        "MATLAB reads. Write the numbers to a .json there, and give that as poses.calibration (the "
        f"cameras are left and right, as their videos must be):\n{MATLAB_SNIPPET}"
    )
