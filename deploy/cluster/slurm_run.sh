#!/usr/bin/env bash
#SBATCH --job-name=goalward
#SBATCH --nodes=2
#SBATCH --ntasks-per-node=1
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --signal=B:TERM@120
# Trains one run on the nodes of a Slurm job: it learns on the first node and acts on all of them.
#
#   sbatch --nodes=5 --cpus-per-task=16 --time=8:00:00 deploy/cluster/slurm_run.sh RUN [TASK] [flags of `goalward train`]
#
# RUN must be on a file system that all nodes share. `goalward` must be on the path, or GOALWARD must name it, with
# its programs beside it, `goalward-gateway` among them. A job that is requeued, by Slurm or because
# its time is over, continues the run.
set -euo pipefail

[ $# -gt 0 ] || { printf 'slurm_run: expected the folder of the run\n' >&2; exit 2; }
run=$1
shift
goalward=${GOALWARD:-goalward}
cores=${SLURM_CPUS_PER_TASK:-${SLURM_CPUS_ON_NODE:-1}}
# Two jobs may have the same first node, so each has a port of its own.
port=${GOALWARD_PORT:-$((20000 + SLURM_JOB_ID % 10000))}

# The key of an earlier start has an outdated address.
rm -f "$run/join.toml"
if [ -e "$run/config.toml" ]; then
    set -- "$@" --resume
fi
"$goalward" train "$@" --run "$run" --no-page --listen "0.0.0.0:$port" &
learner=$!
# Two minutes before the time limit, or when the nodes are needed for another job: writes a checkpoint, and trains the
# rest later.
trap 'is_stopped=yes; kill -TERM "$learner" 2>/dev/null || true' TERM

until [ -e "$run/join.toml" ] || ! kill -0 "$learner" 2>/dev/null; do sleep 0.2; done
if [ "$SLURM_JOB_NUM_NODES" -gt 1 ] && kill -0 "$learner" 2>/dev/null; then
    others=$((SLURM_JOB_NUM_NODES - 1))
    # A node that is lost does not end the others.
    srun --nodes="$others" --ntasks="$others" --exclude="$SLURMD_NODENAME" --no-kill --kill-on-bad-exit=0 \
        bash -c 'exec "$0" join --name "$SLURMD_NODENAME" "$@"' "$goalward" --run "$run" --actors "$cores" &
fi

# A signal ends `wait` but not the learner, unless it came before the learner listened for it.
until wait "$learner"; code=$?; [ "$code" -ne 143 ] || ! kill -0 "$learner" 2>/dev/null; do :; done
if { [ "$code" -eq 130 ] || [ "$code" -eq 143 ]; } && [ "${is_stopped:-}" ]; then
    scontrol requeue "$SLURM_JOB_ID"
fi
exit "$code"
