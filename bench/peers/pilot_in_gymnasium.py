"""Fly Leadtime's pilot in the real LunarLander-v3, beside `leadtime pilot eval` on the same seeds.

    python3 bench/peers/pilot_in_gymnasium.py [WEIGHTS [EPISODES [LEADTIME]]]

WEIGHTS: a policy file (default: the embedded one); LEADTIME: the program. Needs: pip install "gymnasium[box2d]==1.4.0".
Prints one JSON line per weather and simulator; the means agree within two standard errors.
"""
import json
import subprocess
import sys

try:
    import gymnasium as gym
    import numpy as np
except ImportError as missing:
    print(f"skipped: {missing}; pip install 'gymnasium[box2d]==1.4.0'")
    sys.exit(0)

WEIGHTS = sys.argv[1] if len(sys.argv) > 1 else "sims/lander/src/pilot/pilot.safetensors"
EPISODES = int(sys.argv[2]) if len(sys.argv) > 2 else 200
LEADTIME = sys.argv[3] if len(sys.argv) > 3 else "target/release/leadtime"


def read_safetensors(path):
    with open(path, "rb") as file:
        blob = file.read()
    end = 8 + int.from_bytes(blob[:8], "little")
    header = json.loads(blob[8:end])
    header.pop("__metadata__", None)
    tensors = {}
    for name, entry in header.items():
        first, last = entry["data_offsets"]
        dtype = {"F32": "<f4", "F64": "<f8"}[entry["dtype"]]
        tensors[name] = np.frombuffer(blob[end + first:end + last], dtype).reshape(entry["shape"])
    return tensors


def choose(weights, observation):
    x = observation
    for layer in ("actor.0", "actor.1"):
        x = np.tanh(weights[f"{layer}.weight"] @ x + weights[f"{layer}.bias"])
    return int(np.argmax(weights["actor.head.weight"] @ x + weights["actor.head.bias"]))


def fly(weights, wind):
    env = gym.make("LunarLander-v3", enable_wind=wind)
    returns = []
    for seed in range(EPISODES):
        observation, _ = env.reset(seed=seed)
        total, over = 0.0, False
        while not over:
            observation, reward, terminated, truncated, _ = env.step(choose(weights, observation))
            total, over = total + reward, terminated or truncated
        returns.append(total)
    return np.mean(returns), np.std(returns, ddof=1) / len(returns) ** 0.5


def main():
    weights = read_safetensors(WEIGHTS)
    for wind in (False, True):
        mean, error = fly(weights, wind)
        row = {"simulator": f"gymnasium {gym.__version__}", "wind": wind}
        print(json.dumps(row | {"mean_return": round(mean, 1), "standard_error": round(error, 1)}), flush=True)
        command = [LEADTIME, "pilot", "eval", "--pilot", WEIGHTS, "--seeds", f"0..{EPISODES}", "--json"]
        try:
            ours = json.loads(subprocess.check_output(command + ["--wind"] * wind))
        except OSError as missing:
            print(f"skipped: {missing}")
            continue
        print(json.dumps({"simulator": "leadtime", "wind": wind, "mean_return": round(ours["mean_return"], 1),
                          "standard_error": round(ours["standard_error"], 1)}), flush=True)


if __name__ == "__main__":
    main()
