"""Runs a command on a system that lacks what is named: `without.py anonymous,link,noreplace COMMAND...`, as on FUSE, vfat or NFS.

A filter of system calls (seccomp, Linux 3.5) answers as such file systems do: anonymous files (O_TMPFILE) are not supported, hard links not
permitted, renaming without replacement invalid.
"""

import ctypes
import errno
import os
import platform
import struct
import sys

# Numbers of openat, open, linkat, link (aarch64 has neither open nor link) and renameat2, and the machine (linux/audit.h).
CALLS = {
    "x86_64": (257, 2, 265, 86, 316, 0xC000003E),
    "aarch64": (56, None, 37, None, 276, 0xC00000B7),
}
TMPFILE = 0o20000000
LOAD, EQUAL, SET, RETURN = 0x20, 0x15, 0x45, 0x06
ALLOW, ERRNO = 0x7FFF0000, 0x00050000
NUMBER, ARCHITECTURE = 0, 4
NO_NEW_PRIVILEGES, SECCOMP, FILTER = 38, 22, 2


def argument(index):
    """The offset of the lower half of an argument."""
    return 16 + 8 * index


def instruction(code, value, true=0, false=0):
    return struct.pack("<HBBI", code, true, false, value)


def refuse(call, error, index=None, bits=0):
    """Answers `call` with `error`; with `index`, only where that argument has one of `bits`."""
    tested = [] if index is None else [instruction(LOAD, argument(index)), instruction(SET, bits, 0, 1)]
    body = tested + [instruction(RETURN, ERRNO | error)]
    if index is not None:
        body.append(instruction(RETURN, ALLOW))
    return [instruction(LOAD, NUMBER), instruction(EQUAL, call, 0, len(body))] + body


def main():
    lacks, command = sys.argv[1].split(","), sys.argv[2:]
    openat, plain_open, linkat, link, renameat2, machine = CALLS[platform.machine()]
    code = [instruction(LOAD, ARCHITECTURE), instruction(EQUAL, machine, 1, 0), instruction(RETURN, ALLOW)]
    if "anonymous" in lacks:
        code += refuse(openat, errno.EOPNOTSUPP, 2, TMPFILE)
        code += refuse(plain_open, errno.EOPNOTSUPP, 1, TMPFILE) if plain_open is not None else []
    if "link" in lacks:
        code += refuse(linkat, errno.EPERM)
        code += refuse(link, errno.EPERM) if link is not None else []
    if "noreplace" in lacks:
        code += refuse(renameat2, errno.EINVAL, 4, 0xFFFFFFFF)
    code.append(instruction(RETURN, ALLOW))
    program = ctypes.create_string_buffer(b"".join(code))
    header = ctypes.create_string_buffer(struct.pack("@HP", len(code), ctypes.addressof(program)))
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl.argtypes = [ctypes.c_int] + [ctypes.c_ulong] * 4
    for step in [(NO_NEW_PRIVILEGES, 1, 0, 0, 0), (SECCOMP, FILTER, ctypes.addressof(header), 0, 0)]:
        if libc.prctl(*step) != 0:
            sys.exit(f"prctl: {os.strerror(ctypes.get_errno())}")
    os.execvp(command[0], command)


main()
