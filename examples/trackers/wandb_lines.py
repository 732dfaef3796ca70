"""Weights & Biases: leadtime up -c lander --metrics-to 'python3 wandb_lines.py'"""
import json
import sys

import wandb

run = wandb.init(project="leadtime")
for line in sys.stdin:
    update = json.loads(line)
    numbers = {name: value for name, value in update.items() if "/" in name}
    run.log(numbers, step=update["steps"])
run.finish()
