#!/usr/bin/env python3
"""Ends runs at random times, fills their disks, and tries random command lines among a user's files.

Checks what README.md promises under "What a run leaves": maps and texts are whole or not there, a run that was stopped
has written what came before, results of earlier runs stay as they are until they are replaced, and no file that the
program did not make is changed or removed. A study beside the tests: some twenty minutes. Exit code 1 with any finding.
"""
import argparse
import hashlib
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time

TEXTS = ["trajectory.txt", "keyframes.txt", "map.ply", "frames.csv"]
POLITE = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]
MOST_S = 300  # seconds, for any command here; the longest takes ten on a slow computer that does nothing else

findings = []


def finding(what, command):
    findings.append(what)
    print(f"FINDING: {what}\n  after: {' '.join(command)}", flush=True)


def content(path):
    with open(path, "rb") as file:
        return file.read()


def tree(folder):
    """What is there, by path: a file's hash, a link's aim, a folder."""
    all_ = {}
    for place, folders, files in os.walk(folder):
        for name in folders + files:
            path = os.path.join(place, name)
            short = os.path.relpath(path, folder)
            if os.path.islink(path):
                all_[short] = "-> " + os.readlink(path)
            elif os.path.isdir(path):
                all_[short] = "folder"
            elif os.path.isfile(path):
                all_[short] = hashlib.sha256(content(path)).hexdigest()
    return all_


def drafts(folder):
    return [name for name in tree(folder) if name.endswith(".tmp")]


class Program:
    def __init__(self, path):
        self.path = os.path.abspath(path)

    def words(self, arguments):
        return [self.path] + arguments

    def run(self, arguments, folder, check=False, before=None):
        done = subprocess.run(self.words(arguments), cwd=folder, stdin=subprocess.DEVNULL, capture_output=True,
                              timeout=MOST_S, preexec_fn=before, check=False)
        if check and done.returncode != 0:
            sys.exit(f"error: {' '.join(arguments)}: {done.stderr.decode(errors='replace')}")
        return done

    def start(self, arguments, folder):
        return subprocess.Popen(self.words(arguments), cwd=folder, stdin=subprocess.DEVNULL,
                                stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)

    def sound(self, map_, folder):
        return self.run(["map", "info", map_], folder).returncode == 0


def left_running(folder):
    """Processes that still have a file below the folder open or in their command line."""
    found = []
    for pid in filter(str.isdigit, os.listdir("/proc")):
        try:
            command = content(f"/proc/{pid}/cmdline").replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue
        if folder in command and "ffmpeg" in command:
            found.append(command)
    return found


def listed_as_they_are(folder):
    """Whether each result in a folder is one that its list knows: whole, of an earlier run or of this one."""
    known = set()
    try:
        for line in content(os.path.join(folder, ".pocket-ptam")).decode().splitlines()[1:]:
            _, size, name = line.split(" ", 2)
            known.add((name, int(size)))
    except FileNotFoundError:
        pass
    there = {name for name, kind in tree(folder).items() if kind != "folder"}
    there -= {".pocket-ptam"} | set(drafts(folder))
    return [name for name in there if (name, os.path.getsize(os.path.join(folder, name))) not in known]


def whole(program, folder, older_map, command):
    """What holds after any end of a run."""
    map_ = os.path.join(folder, "m.map")
    if os.path.exists(map_) and not program.sound("m.map", folder):
        finding("a map that is not whole", command)
    if older_map is not None and not os.path.exists(map_):
        finding("the older map is gone", command)
    for name in listed_as_they_are(os.path.join(folder, "o")):
        finding(f"{name} is no whole result of a run", command)
    for name in TEXTS:
        path = os.path.join(folder, "o", name)
        if os.path.exists(path) and content(path)[-1:] not in (b"\n", b""):
            finding(f"{name} breaks off", command)


def run_arguments(chosen, sequence, seed_map):
    arguments = chosen.choice([
        ["replay", sequence, "--calibration", sequence + "/calibration.yaml"],
        ["replay", sequence, "--calibration", sequence + "/calibration.yaml", "--every", "2"],
        ["sim", "--duration", "3", "--seed", str(chosen.randrange(3))],
    ])
    arguments = arguments + ["--out", "o", "--save-map", "m.map"]
    if chosen.random() < 0.3:
        arguments += ["--load-map", seed_map] if arguments[0] == "replay" else ["--no-noise"]
    if chosen.random() < 0.4:
        arguments += ["--no-overlay"]
    if chosen.random() < 0.4:
        arguments += ["--no-report"]
    return arguments


def kill_at_random(program, chosen, work, sequence, seed_map, count):
    ended = {}
    typical_s = 3.0
    for i in range(count):
        folder = os.path.join(work, "kill")
        shutil.rmtree(folder, ignore_errors=True)
        os.makedirs(folder)
        arguments = run_arguments(chosen, sequence, seed_map)
        older_map = None
        if chosen.random() < 0.5:  # results of an earlier run are there
            begin = time.monotonic()
            program.run(arguments, folder)
            typical_s = 0.7 * typical_s + 0.3 * (time.monotonic() - begin)
            if os.path.exists(os.path.join(folder, "m.map")):
                older_map = content(os.path.join(folder, "m.map"))
        before = tree(folder)
        began_ns = time.time_ns()
        which = chosen.choice(POLITE + [signal.SIGKILL])
        after_s = chosen.uniform(0, 1.1 * typical_s)
        child = program.start(arguments, folder)
        time.sleep(after_s)
        child.send_signal(which)
        said = child.communicate(timeout=MOST_S)[1].decode(errors="replace")
        command = arguments + [f"# {which.name} after {after_s:.3f} s"]
        code = child.returncode
        ended[(which.name, code)] = ended.get((which.name, code), 0) + 1
        whole(program, folder, older_map, command)
        if which == signal.SIGKILL:
            drafts_made = set(drafts(folder))
            for name in drafts_made:
                if not os.path.basename(name).startswith(".pocket-ptam-"):
                    finding(f"the draft {name} has another name than README.md says", command)
                os.unlink(os.path.join(folder, name))
        else:
            if drafts(folder):
                finding(f"drafts are left: {drafts(folder)}", command)
            if left_running(folder):
                finding(f"still running: {left_running(folder)}", command)
            if code == -which and {k: v for k, v in tree(folder).items() if v != "folder" and k != "o/.pocket-ptam"} != {
                    k: v for k, v in before.items() if v != "folder" and k != "o/.pocket-ptam"}:
                finding("ended before the run began, and yet files differ", command)
            stopped = f"stopped by {which.name}" in said
            if code == 1 and not stopped and "nothing was saved" not in said:
                finding(f"exit code 1 without a reason: {said}", command)
            if stopped:
                for name in TEXTS:
                    path = os.path.join(folder, "o", name)
                    if not os.path.exists(path):
                        finding(f"stopped, and {name} is not there", command)
                    elif os.stat(path).st_mtime_ns < began_ns:
                        finding(f"stopped, and {name} is that of the run before", command)
                if not os.path.exists(os.path.join(folder, "m.map")) and "nothing was saved" not in said:
                    finding("stopped, and neither map nor word of it", command)
            if code not in (0, 1, -which):
                finding(f"exit code {code}: {said}", command)
        again = ["replay", sequence, "--fov", "40", "--every", "10", "--no-overlay", "--no-report", "--out", "o"]
        if program.run(again + ["--save-map", "m.map"], folder).returncode == 2:  # 1: so few frames make no map
            finding("the next run is refused", command)
        if sys.stderr.isatty():
            print(f"\rkill {i + 1} of {count}", end="", file=sys.stderr)
    print(f"{count} runs ended at random times. Signal, exit code: how often")
    for (name, code), times in sorted(ended.items()):
        print(f"  {name:8} {code:4}: {times}")


def judge_failed_outputs(program, folder, done, command):
    said = done.stderr.decode(errors="replace")
    there = tree(folder)
    whole(program, folder, None, command)
    if drafts(folder):
        finding(f"drafts are left: {drafts(folder)}", command)
    if done.returncode == 2 and [name for name in there if name != "filler"]:
        finding(f"exit code 2, and yet there is {sorted(there)}", command)
    if done.returncode not in (0, 1, 2):
        finding(f"exit code {done.returncode}: {said}", command)
    if done.returncode == 2:
        return
    for name in ["o/" + text for text in TEXTS] + ["m.map"]:
        if name not in there and os.path.basename(name) not in said and "nothing was saved" not in said:
            finding(f"{name} is neither there nor named in: {said}", command)
        if name not in there and done.returncode == 0 and name != "m.map":
            finding(f"exit code 0 without {name}", command)


def fill_disks(program, chosen, work, sequence, seed_map, count):
    ended = {}
    root = os.geteuid() == 0
    for i in range(count):
        folder = os.path.join(work, "disk")
        os.makedirs(folder, exist_ok=True)
        arguments = run_arguments(chosen, sequence, seed_map)
        kind = chosen.choice(["small disk", "disk filled during the run"] if root else ["files limited"])
        if kind == "files limited" or chosen.random() < 0.3:
            kind, most = "files limited", chosen.randrange(0, 2 << 20)
            done = program.run(arguments, folder, before=lambda most=most: resource.setrlimit(
                resource.RLIMIT_FSIZE, (most, most)))
            judge_failed_outputs(program, folder, done, arguments + [f"# files of at most {most} bytes"])
            shutil.rmtree(folder)
        else:
            size_kb = chosen.randrange(32, 3000) if kind == "small disk" else 8000
            subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size_kb}k", "none", folder], check=True)
            child = program.start(arguments, folder)
            try:
                after_s = chosen.uniform(0, 2.5)
                if kind != "small disk":
                    time.sleep(after_s)
                    try:
                        with open(os.path.join(folder, "filler"), "wb", buffering=0) as filler:
                            while filler.write(bytes(4096)) == 4096:
                                pass
                    except OSError:
                        pass
                said = child.communicate(timeout=MOST_S)[1]
                done = subprocess.CompletedProcess(arguments, child.returncode, b"", said)
                judge_failed_outputs(program, folder, done,
                                     arguments + [f"# {kind}, {size_kb} kB, filled after {after_s:.3f} s"])
            finally:
                child.kill()  # had this program been interrupted
                child.wait()
                subprocess.run(["umount", folder], check=True)
        ended[(kind, done.returncode)] = ended.get((kind, done.returncode), 0) + 1
        if sys.stderr.isatty():
            print(f"\rdisk {i + 1} of {count}", end="", file=sys.stderr)
    print(f"{count} runs whose outputs failed. What failed, exit code: how often")
    for (kind, code), times in sorted(ended.items()):
        print(f"  {kind:27} {code:2}: {times}")
    if not root:
        print("  full disks are for root alone, who may mount them: left out")


def make_users_tree(program, home, sequence, seed_map):
    """Files as a user may have them, some with the names of results, and results of a run."""
    os.makedirs(home)
    shutil.copytree(sequence, os.path.join(home, "seq"))
    images = sorted(os.listdir(os.path.join(home, "seq/rgb")))
    shutil.copy(os.path.join(home, "seq/rgb", images[0]), os.path.join(home, "photo.png"))
    shutil.copy(seed_map, os.path.join(home, "town.map"))
    os.makedirs(os.path.join(home, "old"))
    subprocess.run(["ffmpeg", "-nostdin", "-v", "error", "-framerate", "15", "-pattern_type", "glob", "-i",
                    os.path.join(home, "seq/rgb/*.png"), "-pix_fmt", "yuv420p", os.path.join(home, "overlay.mp4")],
                   check=True)
    shutil.copy(os.path.join(home, "overlay.mp4"), os.path.join(home, "clip.mp4"))
    texts = {"notes.txt": "my notes\n", "trajectory.txt": "1 0 0 0 0 0 0 1\n2 1 0 0 0 0 0 1\n3 1 1 0 0 0 0 1\n",
             "papers/report.html": "<p>mine</p>\n", "papers/cameras.txt": "mine\n", "papers/images/keyframe_000001.png":
             "mine\n", "plot.svg": "<svg/>\n", "scan.ply": "ply\nmine\n", "old/map.ply": "mine\n", "notes.map": "mine\n",
             "papers/.pocket-ptam-notes.tmp": "mine, though named like a draft\n"}
    for name, text in texts.items():
        os.makedirs(os.path.dirname(os.path.join(home, name)), exist_ok=True)
        with open(os.path.join(home, name), "w", encoding="utf-8") as file:
            file.write(text)
    os.symlink("seq", os.path.join(home, "link"))
    os.symlink("town.map", os.path.join(home, "link.map"))
    os.symlink("nowhere", os.path.join(home, "dangling.map"))
    os.link(os.path.join(home, "seq/groundtruth.txt"), os.path.join(home, "truth.txt"))
    before = tree(home)
    program.run(["sim", "--duration", "1", "--out", "results"], home, check=True)
    return before


def random_command(chosen, places):
    place = lambda: chosen.choice(places)  # noqa: E731
    new = lambda: chosen.choice(["new", "new/er", "new.map", "n.ply", "a b", "-x", "./new/.", "papers/new"])  # noqa: E731
    any_ = lambda: place() if chosen.random() < 0.5 else new()  # noqa: E731
    outputs = [["--out", any_()], ["--save-map", any_()], ["--no-overlay"], ["--no-report"]]
    options = {
        "sim": outputs + [["--seed", str(chosen.randrange(3))], ["--dump", any_()], ["--load-map", "town.map"]],
        "replay": outputs + [["--calibration", chosen.choice(["seq/calibration.yaml", place()])],
                             ["--load-map", chosen.choice(["town.map", place()])], ["--rotate", "90"],
                             ["--resize", "120x160"], ["--every", "5"], ["--fps", "15"]],
        "readout": [["--axis", "rows"], ["--resize", "80x80"]],
        "eval": [["--plot", any_()], [place()]],
        "info": [], "export": [["--ply", any_()], ["--colmap", any_()]]}
    name = chosen.choice(["sim", "replay", "replay", "replay", "eval", "info", "export", "export", "readout"])
    words = {"sim": ["sim", "--duration", "0.3"],
             "replay": ["replay", chosen.choice(["seq", "clip.mp4", "overlay.mp4", "photo.png", place()]), "--fov", "50"],
             "readout": ["readout", chosen.choice(["photo.png", place()]), "--every", "20", "--fov", "50"],
             "eval": ["eval", chosen.choice(["trajectory.txt", place()]), chosen.choice(["truth.txt", place()])],
             "info": ["map", "info", place()],
             "export": ["map", "export", chosen.choice(["town.map", "link.map", place()])]}[name]
    chosen_options = chosen.sample(options[name], min(len(options[name]), chosen.randrange(5)))
    return words + [word for option in chosen_options for word in option]


def try_command_lines(program, chosen, work, sequence, seed_map, count):
    home = os.path.join(work, "home")
    users = make_users_tree(program, home, sequence, seed_map)
    ended = {}
    edited = 0
    for i in range(count):
        places = sorted(tree(home)) + [".", "..", "/dev/full", "/dev/null", home + "/seq", "seq/../photo.png"]
        places = [place for place in places if not place.startswith("seq/rgb/")] + ["seq/rgb", "seq/rgb/missing.png"]
        if chosen.random() < 0.05:  # the user changes something that the program made, which is the user's from then on
            made = [name for name, kind in tree(home).items() if name not in users and kind != "folder"
                    and not kind.startswith("->") and not name.endswith(".pocket-ptam")]
            if made:
                name = chosen.choice(sorted(made))
                with open(os.path.join(home, name), "ab") as file:
                    file.write(b"edited\n")
                users[name] = tree(home)[name]
                edited += 1
        arguments = random_command(chosen, places)
        try:
            code = program.run(arguments, home).returncode
        except subprocess.TimeoutExpired:
            finding(f"over {MOST_S} s", arguments)
            code = "late"
        ended[code] = ended.get(code, 0) + 1
        if code not in (0, 1, 2, "late"):
            finding(f"exit code {code}", arguments)
        now = tree(home)
        for name, was in users.items():
            if now.get(name) != was:
                finding(f"the user's {name} was {was} and is {now.get(name)}", arguments)
                users[name] = now.get(name)
        if drafts(home) != ["papers/.pocket-ptam-notes.tmp"]:
            finding(f"drafts are left: {drafts(home)}", arguments)
        if sys.stderr.isatty():
            print(f"\rcommand {i + 1} of {count}", end="", file=sys.stderr)
    print(f"{count} command lines among {len(users)} files, links and folders of a user's, {edited} of them edited "
          "results. Exit code: how often")
    for code, times in sorted(ended.items(), key=str):
        print(f"  {code}: {times}")


def main():
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("program", help="build/release/pocket-ptam")
    options.add_argument("--seed", type=int, default=int(time.time()))
    options.add_argument("--kills", type=int, default=200)
    options.add_argument("--disks", type=int, default=100)
    options.add_argument("--commands", type=int, default=1000)
    given = options.parse_args()
    print(f"seed {given.seed}", flush=True)
    program = Program(given.program)
    work = tempfile.mkdtemp(prefix="pptam-interruptions-")
    try:
        sequence, seed_map = os.path.join(work, "sequence"), os.path.join(work, "seed.map")
        program.run(["sim", "--duration", "3", "--dump", sequence], work, check=True)
        program.run(["sim", "--duration", "3", "--no-overlay", "--out", "first", "--save-map", seed_map], work,
                    check=True)
        for name, study, count in [("kills", kill_at_random, given.kills), ("disks", fill_disks, given.disks),
                                   ("commands", try_command_lines, given.commands)]:
            if count > 0:
                study(program, random.Random(f"{given.seed} {name}"), work, sequence, seed_map, count)
    finally:
        shutil.rmtree(work, ignore_errors=True)
    print(f"{len(findings)} findings")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
