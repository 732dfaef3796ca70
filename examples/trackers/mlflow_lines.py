"""MLflow: leadtime up -c lander --metrics-to 'python3 mlflow_lines.py'"""
import json
import sys

import mlflow

mlflow.set_experiment("leadtime")
with mlflow.start_run():
    for line in sys.stdin:
        update = json.loads(line)
        numbers = {name: value for name, value in update.items() if "/" in name}
        mlflow.log_metrics(numbers, step=update["steps"])
