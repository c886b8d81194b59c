#!/usr/bin/env bash
# The campaigns of the data, one after the other: every file first to a thousand samples, then to ten and to forty thousand.
#
#   bench/long_run.sh FOLDER [JOBS]
#
# Interrupt it as you like; the same command continues. Give it a folder of its own, a PYTHON, and hours:
#   PYTHON=.venv/bin/python setsid nohup nice -n 19 bench/long_run.sh FOLDER 2 >FOLDER/log 2>&1 &
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
folder=$1 jobs=${2:-2}
mkdir -p "$folder"
export PYTHONPATH=$PWD OMP_NUM_THREADS=1

# run FILE SCENARIO SAMPLES OPTIONS...
run() {
    local file=$1 scenario=$2 samples=$3
    shift 3
    date "+%F %T $file to $samples"
    "${PYTHON:-python}" -m reference.tsid.campaign "$scenario" --samples "$samples" -o "$folder/$file.parquet" --seed 2018 \
        --jobs "$jobs" "$@"
}

# others SAMPLES: the same scenarios with arms as strong as HRP-2's, and another robot
others() {
    for scenario in three four; do
        run "${scenario}_strong_arms" "$scenario" "$1" --robot talos_strong_arms --states 1000
    done
    for scenario in two_coplanar two; do
        run "${scenario}_g1" "$scenario" "$1" --robot g1 --states 1000
    done
}

limits="standard straight no_torque no_position no_position_torque no_position_velocity no_limits"
for samples in 1000 10000 40000; do
    for scenario in three four two two_coplanar four_strong; do
        run "$scenario" "$scenario" "$samples"
    done
    if ((samples == 1000)); then others 1000; fi
    if ((samples == 10000)); then
        for scenario in three two; do
            run "${scenario}_ablations" "$scenario" 2000 --all --controllers $limits
            run "${scenario}_zero_momentum" "$scenario" 2000 --all --zero-momentum --controllers standard constant_momentum
        done
        others 5000
    fi
done
