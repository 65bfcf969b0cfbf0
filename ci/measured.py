"""Runs a program and measures its whole process: the scripts that compare this program with others import it."""
import os, pathlib, subprocess, sys, time


class Problem(Exception):
    """A message for the user."""


def measured(command, log, environment=None, cwd=None):
    """Wall and CPU seconds of a process with its children, the peak memory of the largest of them, and what it printed."""
    start = time.monotonic()
    with open(log, "w") as output:
        process = subprocess.Popen(list(map(str, command)), stdout=output, stderr=subprocess.STDOUT, env=environment, cwd=cwd)
        _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    text = pathlib.Path(log).read_text(errors="replace")
    if process.returncode != 0:
        raise Problem(f"exit code {process.returncode}: {' '.join(map(str, command))}\n{text[-2000:]}")
    # Linux counts kilobytes, macOS bytes.
    memory = usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    return {"wall": time.monotonic() - start, "cpu": usage.ru_utime + usage.ru_stime, "memory": memory}, text
