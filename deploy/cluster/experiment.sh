#!/usr/bin/env bash
#SBATCH --job-name=goalward-experiment
#SBATCH --array=1-@TASKS@
#SBATCH --cpus-per-task=@CORES@
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --signal=B:TERM@120
# The job that `goalward experiment --on slurm` submits: each task trains the next missing run until none is left. A
# task that is requeued continues the runs that it had.
set -euo pipefail

@COMMAND@ &
experiment=$!
# Two minutes before the time limit, or when the node is needed for another job: writes checkpoints, and trains the rest
# later.
trap 'is_stopped=yes; kill -TERM "$experiment" 2>/dev/null || true' TERM
# A signal ends `wait` but not the experiment, unless it came before the experiment listened for it.
until wait "$experiment"; code=$?; [ "$code" -ne 143 ] || ! kill -0 "$experiment" 2>/dev/null; do :; done
if { [ "$code" -eq 130 ] || [ "$code" -eq 143 ]; } && [ "${is_stopped:-}" ]; then
    scontrol requeue "${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID"
fi
exit "$code"
