"""Checks the files under deploy/ and the checks themselves: each has to find a misspelling in a copy. See check.sh."""

import json
import re
import shutil
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

DEPLOY = Path(__file__).resolve().parent
# The exposure of a unit that `systemd-analyze security` still calls good.
MAX_EXPOSURE = 2.5
# What no schema of Kubernetes itself describes.
FOREIGN = {"kustomization.yaml", "podmonitor.yaml"}


def run(*command, **more):
    return subprocess.run([str(part) for part in command], capture_output=True, text=True, **more)


def systemd(folder):
    """An unknown key is only a warning with exit code 0, so whatever is printed is a finding."""
    with tempfile.TemporaryDirectory() as scratch:
        names = []
        for unit in sorted(folder.iterdir()):
            text = unit.read_text().replace("/usr/bin/leadtime", "/bin/true")
            name = unit.name.replace("@.", "@x.")
            (Path(scratch) / unit.name).write_text(text)
            names.append(Path(scratch) / name if unit.name == name else Path(scratch) / name)
            if unit.name != name:
                (Path(scratch) / name).write_text(text)
        done = run("systemd-analyze", "verify", "--man=no", *names)
        found = [line for line in (done.stdout + done.stderr).splitlines() if line.strip()]
        for unit in names:
            if unit.suffix != ".service" or unit.name.startswith("leadtime-new-certs"):
                continue
            done = run("systemd-analyze", "security", "--offline=true", "--no-pager", unit)
            exposure = re.search(r"exposure level for \S+: ([\d.]+)", done.stdout)
            if not exposure or float(exposure[1]) > MAX_EXPOSURE:
                found.append(f"{unit.name}: exposure {exposure and exposure[1]}, at most {MAX_EXPOSURE}")
        return found


def compose(file):
    """The published schema, as check-jsonschema brings it."""
    done = run("check-jsonschema", "--builtin-schema", "vendor.compose-spec", file)
    return [] if done.returncode == 0 else (done.stdout + done.stderr).splitlines()


def image(file):
    done = run("hadolint", file)
    return done.stdout.splitlines() + done.stderr.splitlines()


def kubernetes(folder):
    import kubernetes_validate
    import yaml

    found = []
    for file in sorted(folder.glob("*.yaml")):
        for document in yaml.safe_load_all(file.read_text()):
            if file.name in FOREIGN:
                continue
            try:
                kubernetes_validate.validate(document, "1.37", strict=True)
            except Exception as error:
                found.append(f"{file.name}: {str(error).splitlines()[0]}")
    listed = yaml.safe_load((folder / "kustomization.yaml").read_text())["resources"]
    found += [f"kustomization.yaml: no file {name}" for name in listed if not (folder / name).exists()]
    return found


def names(folder):
    """Every name that the dashboard and the alerts ask for has a row in docs/metrics.md."""
    page = (DEPLOY.parent / "docs/metrics.md").read_text()
    known = set(re.findall(r"^\| `(leadtime_\w+)`", page, flags=re.M))
    known |= {f"leadtime_staleness_{end}" for end in ("bucket", "sum", "count")}
    found = []
    for file in (folder / "leadtime.json", folder / "alerts.yaml"):
        asked = set(re.findall(r"leadtime_\w+", file.read_text()))
        found += [f"{file.name}: there is no {name}" for name in sorted(asked - known)]
    panels = json.loads((folder / "leadtime.json").read_text())["panels"]
    found += [f"leadtime.json: panel {it['title']} asks for nothing" for it in panels if not it["targets"]]
    return found


def alerts(folder):
    """Their syntax, and whether they notice what they are for."""
    for command in (("check", "rules", folder / "alerts.yaml"), ("test", "rules", folder / "alerts_test.yaml")):
        done = run("promtool", *command)
        if done.returncode != 0:
            return (done.stdout + done.stderr).splitlines()
    return []


def context(top):
    """The two engines read a file each, and the keys of certificates stay out of what is built."""
    found = []
    ignored = [(top / name).read_text() for name in (".containerignore", ".dockerignore")]
    if ignored[0] != ignored[1]:
        found.append(".containerignore and .dockerignore differ")
    found += [f".containerignore: {it} is not in it" for it in ("**/tls", "**/*.key") if it not in ignored[0].split()]
    return found


def settings(unit):
    """Returns the settings of a unit, the last of each name."""
    return dict(line.split("=", 1) for line in unit.read_text().splitlines() if "=" in line and line[0] != "#")


def promises(folder):
    """What keeps a run going, and is right by every schema if it is missing."""
    import yaml

    found = []

    def expect(is_so, sentence):
        if not is_so:
            found.append(sentence)

    # A learner that is restarted dismisses its actors with exit code 0.
    actor = settings(folder / "systemd/leadtime-actor@.service")
    expect(actor.get("Restart") == "always", "leadtime-actor@.service: a dismissed actor does not come back")
    expect(actor.get("RestartPreventExitStatus") == "2", "leadtime-actor@.service: wrong input is tried again")
    # The soft limit is 1,024 otherwise, which connections without a certificate use up.
    for unit in sorted((folder / "systemd").glob("*.service")):
        known = settings(unit)
        if "--listen" in known.get("ExecStart", ""):
            expect(int(known.get("LimitNOFILE", 0)) >= 4096, f"{unit.name}: too few open files for its connections")
    again = settings(folder / "systemd/leadtime-new-certs.service")["ExecStart"]
    expect("--no-block" in again.split(), "leadtime-new-certs.service: waits for actors, and misses the next renewal")
    services = yaml.safe_load((folder / "compose.yaml").read_text())["services"]
    for name, service in services.items():
        if service["command"][0] == "actor":
            expect(service["restart"] == "unless-stopped", f"compose.yaml: {name}, dismissed, does not come back")

    # Without a learner no actor is ready, and a budget of ready ones keeps every node.
    budgets = [it for it in yaml.safe_load_all((folder / "kubernetes/actors.yaml").read_text()) if it["kind"] == "PodDisruptionBudget"]
    expect(all(it["spec"].get("unhealthyPodEvictionPolicy") == "AlwaysAllow" for it in budgets), "actors.yaml: actors without a learner keep their nodes")

    # A PodMonitor labels what it scrapes with the pod, so an adapter finds it there alone.
    scaler = yaml.safe_load((folder / "kubernetes/autoscaler.yaml").read_text())["spec"]["metrics"][0]["object"]["describedObject"]
    sets = [it for it in yaml.safe_load_all((folder / "kubernetes/learner.yaml").read_text()) if it["kind"] == "StatefulSet"]
    pod = ("Pod", sets[0]["metadata"]["name"] + "-0")
    expect((scaler["kind"], scaler["name"]) == pod, f"autoscaler.yaml: nothing serves the metric of {scaler['name']}")

    # A certificate that is renewed in time must never be alarmed about.
    alert = re.search(r"certificate_end_timestamp_seconds - time\(\) < (\d+) \* 86400", (folder / "grafana/alerts.yaml").read_text())
    page = (DEPLOY.parent / "docs/operations.md").read_text()
    lifetime, before = re.search(r"`--lifetime (\d+)d`, and `certs renew --before (\d+)d`", page).groups()
    expect(int(alert[1]) < int(before) < int(lifetime), "alerts.yaml: certificates as docs/operations.md recommends them are alarmed about")

    # What the compose file's first lines make is what it reads.
    text = (folder / "compose.yaml").read_text()
    made = re.search(r"certs init (\S+)", text)[1]
    for name, secret in yaml.safe_load(text)["secrets"].items():
        read = (folder / secret["file"]).resolve().parent
        expect(read == (folder.parent / made.replace("deploy", folder.name, 1)).resolve(), f"compose.yaml: {name} is not in {made}")
    text = (folder / "container/Containerfile").read_text()
    expect("chmod 1777 /image/var/lib/leadtime /image/var/lib/leadtime/runs" in text, "Containerfile: only one user may make a run")
    given = [line for line in text.splitlines() if line.startswith("COPY --from") and "--chown" in line]
    expect(all(" /image/var/lib/ " in line for line in given), "Containerfile: a user owns more than the place of the runs")
    return found


# Name, what it needs, what it checks, and a misspelling: in which file, which word becomes which.
CHECKS = [
    ("units", lambda: shutil.which("systemd-analyze"), systemd, "systemd",
     [("leadtime-learner@.service", "TimeoutStopSec", "TimeoutStopSecs"), ("leadtime-certs.timer", "OnCalendar=daily", "OnCalendar=never"),
      ("leadtime-router.service", "CapabilityBoundingSet=\n", "")]),
    ("compose file", lambda: shutil.which("check-jsonschema"), compose, "compose.yaml", [("", "stop_grace_period", "stop_grace_periods")]),
    ("image file", lambda: shutil.which("hadolint"), image, "container/Containerfile", [("", "STOPSIGNAL", "STOPSIGNALS")]),
    ("manifests", lambda: find_spec("kubernetes_validate"), kubernetes, "kubernetes",
     [("learner.yaml", "terminationGracePeriodSeconds", "terminationGracePeriodSecond"), ("actors.yaml", "readinessProbe", "readinessProbes"),
      ("autoscaler.yaml", "maxReplicas", "maxReplica"), ("network.yaml", "policyTypes", "policyType")]),
    ("names of metrics", lambda: True, names, "grafana",
     [("leadtime.json", "leadtime_wait_ratio", "leadtime_wait_ration"), ("alerts.yaml", "leadtime_books_imbalance", "leadtime_book_imbalance")]),
    ("alerts", lambda: shutil.which("promtool"), alerts, "grafana",
     [("alerts.yaml", "increase(", "increases("), ("alerts.yaml", "severity", "severity:"), ("alerts.yaml", " unless on", " and on"), ("alerts.yaml", "unsaved_seconds > 60", "unsaved_seconds > 600")]),
    ("promises", lambda: find_spec("yaml"), promises, ".",
     [("systemd/leadtime-actor@.service", "Restart=always", "Restart=on-failure"), ("systemd/leadtime-router.service", "LimitNOFILE", "LimitNPROC"), ("systemd/leadtime-new-certs.service", " --no-block", ""), ("compose.yaml", "unless-stopped", "on-failure"),
      ("grafana/alerts.yaml", "2 * 86400", "10 * 86400"), ("kubernetes/autoscaler.yaml", "kind: Pod,", "kind: Service,"), ("kubernetes/actors.yaml", "AlwaysAllow", "IfHealthyBudget"), ("compose.yaml", "init deploy/tls", "init tls"), ("container/Containerfile", "chmod 1777", "chmod 0755"),
      ("container/Containerfile", "build /image/usr", "build --chown=1:1 /image/usr")]),
    ("ignored files", lambda: True, context, "..", []),
]


def misspelt(path, file, word, wrong, scratch):
    """Returns a copy in which one word is wrong."""
    copy = Path(scratch) / path.name
    if path.is_dir():
        shutil.copytree(path, copy)
    else:
        shutil.copy(path, copy)
    target = copy / file if file else copy
    text = target.read_text()
    assert word in text, f"{target.name} has no {word}"
    target.write_text(text.replace(word, wrong, 1))
    return copy


def main():
    failures = 0
    for name, is_there, check, path, misspellings in CHECKS:
        if not is_there():
            print(f"skipped: {name}: its tool is not here")
            continue
        path = DEPLOY / path
        found = check(path)
        for file, word, wrong in misspellings:
            with tempfile.TemporaryDirectory() as scratch:
                if not check(misspelt(path, file, word, wrong, scratch)):
                    found.append(f"the check does not find `{wrong.strip()}` for `{word.strip()}` in {file or path.name}")
        failures += len(found)
        print(f"{'FAILED' if found else 'valid'}: {name}, {len(misspellings)} misspellings tried")
        print("".join(f"  {line}\n" for line in found), end="")
    sys.exit(1 if failures else 0)


main()
