"""LinuxCNC's own kinematics: its compiled modules, with what they ask of its HAL in their place."""

from __future__ import annotations

import ctypes
import os
import re
import subprocess
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

MODULES = Path(os.environ.get("LINUXCNC_MODULES", "/usr/lib/linuxcnc/modules"))
"""Of Debian's package ``linuxcnc-uspace``."""
_HAL = """
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
static struct { char name[48]; void *value; } pins[256];
static int count;
static int made(void **data, const char *name, va_list values) {
    vsnprintf(pins[count].name, sizeof pins[0].name, name, values);
    *data = pins[count++].value = calloc(1, 8);
    return 0;
}
#define PIN(kind) \\
    int hal_pin_##kind##_newf(int way, void **data, int id, const char *name, ...) { \\
        va_list values; va_start(values, name); return made(data, name, values); } \\
    int hal_pin_##kind##_new(const char *name, int way, void **data, int id) { \\
        return hal_pin_##kind##_newf(way, data, id, "%s", name); }
PIN(float) PIN(bit) PIN(s32) PIN(u32)
int hal_init(const char *name) { return 1; }
int hal_ready(int id) { return 0; }
int hal_exit(int id) { return 0; }
void *hal_malloc(long size) { return calloc(1, size); }
void rtapi_print(const char *text, ...) {}
void rtapi_print_msg(int level, const char *text, ...) {}
int setp(const char *name, double value) {
    for (int i = count; i-- > 0;)  /* the last first: a module may be set up again */
        if (!strcmp(pins[i].name, name)) { *(double *)pins[i].value = value; return 0; }
    return 1;
}
"""


@cache
def _hal() -> ctypes.CDLL:
    """Return what modules ask for, compiled: pins, which ``setp`` sets."""
    with TemporaryDirectory() as folder:
        library = Path(folder, "hal.so")
        command = ["cc", "-shared", "-fPIC", "-x", "c", "-o", str(library), "-"]
        subprocess.run(command, input=_HAL, text=True, check=True)
        return ctypes.CDLL(str(library), ctypes.RTLD_GLOBAL)


class LinuxcncKinematics:
    """A module of LinuxCNC, set up by the lines of a HAL file: joints of poses, and back."""

    def __init__(self, kind: str, lines: str) -> None:
        hal = _hal()
        self._module = ctypes.CDLL(str(MODULES / f"{kind}.so"))
        assert self._module.rtapi_app_main() == 0
        for name, value in re.findall(r"^setp (\S+) (\S+)$", lines, re.MULTILINE):
            assert hal.setp(name.encode(), ctypes.c_double(float(value))) == 0, name

    def inverse(self, pose: Sequence[float], count: int) -> list[float]:
        """Return the joints of a pose X Y Z A B C [mm], [deg]."""
        joints, flags = (ctypes.c_double * 16)(), (ctypes.c_ulong * 4)()
        at = (ctypes.c_double * 9)(*pose)
        assert self._module.kinematicsInverse(at, joints, flags, flags) == 0
        return joints[:count]

    def forward(self, joints: Sequence[float], near: Sequence[float]) -> list[float]:
        """Return the pose of joints, sought from one near it; NaN if it is not found."""
        pose, flags = (ctypes.c_double * 9)(*near), (ctypes.c_ulong * 4)()
        driven = (ctypes.c_double * 16)(*joints)
        failed = self._module.kinematicsForward(driven, pose, flags, flags) != 0
        return [float("nan")] * len(near) if failed else pose[: len(near)]
