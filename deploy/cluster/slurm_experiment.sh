#!/usr/bin/env bash
#SBATCH --job-name=goalward-experiment
#SBATCH --array=1-4
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --signal=B:TERM@120
# Trains the runs of plans over the tasks of a Slurm array: each task takes what is next, one run for two of its
# cores, until none is missing.
#
#   sbatch --array=1-20 --cpus-per-task=4 --time=8:00:00 deploy/cluster/slurm_experiment.sh PLAN.toml... [--out DIR]
#
# The folder of the runs, experiments/ unless --out says otherwise, lies on a file system that all nodes share and that
# has locks (flock), as NFS and Lustre have. `goalward` is on the path, or GOALWARD says where it is. A task that is
# requeued continues the run that it had; `goalward experiment PLAN.toml --dry-run` says what is missing, meanwhile and
# afterwards.
set -euo pipefail

[ $# -gt 0 ] || { printf 'slurm_experiment: expected a plan\n' >&2; exit 2; }
cores=${SLURM_CPUS_PER_TASK:-${SLURM_CPUS_ON_NODE:-1}}
"${GOALWARD:-goalward}" experiment "$@" --jobs $(((cores + 1) / 2)) &
experiment=$!
# Two minutes before the time is over, or when somebody wants the node: checkpoints, and later the rest.
trap 'kill -TERM "$experiment"; is_stopped=yes' TERM
# A signal ends a wait, not the experiment.
until wait "$experiment"; code=$?; [ "$code" -ne $((128 + 15)) ]; do :; done
if [ "$code" -eq 130 ] && [ "${is_stopped:-}" ]; then
    scontrol requeue "${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID"
fi
exit "$code"
