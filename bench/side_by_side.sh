#!/usr/bin/env bash
# Benchmarks beside their peers, one after the other.
#
#     bench/side_by_side.sh [-n ROUNDS, default 5] [-s SECONDS, default 30] [PART ...]
#
# Parts, all of them if none is named: roofline, lander, highway, steakhouse, notifier, inference, lstm (inference with an LSTM), acting,
# update, worlds (in Python), whole (whole systems). After the build all take about half an hour: `whole` two minutes a round, `update` four.
#
# Whole systems take turns: each round runs every one of them once, and what is printed are medians of the rounds. Ours make 1e6 steps, and
# peers take SECONDS. Everything runs on one core, but updates, which have rows with two threads, and whole systems, which have two cores.
#
# PYTHON names the interpreter that has the peers (gymnasium[box2d], envpool, highway-env, torch) and the package `leadtime`; SF_PYTHON the
# one that has sample-factory, which holds Gymnasium below 1.0 (default: PYTHON). A peer whose packages are missing says so. LEADTIME names a
# program that is to be taken instead of one that is built.
set -euo pipefail

usage() { sed -n '/^#  *bench/,/^set/{/^#/p}' "$0" | sed 's/^# \{0,1\}//'; }

rounds=5 seconds=30
while getopts n:s:h option; do
    case $option in
        n) rounds=$OPTARG ;;
        s) seconds=$OPTARG ;;
        h) usage && exit 0 ;;
        *) usage >&2 && exit 2 ;;
    esac
done
shift $((OPTIND - 1))
# The bench of every part; some have none.
declare -A bench_of=([roofline]=roofline [lander]=lander [highway]=highway [steakhouse]=steakhouse [notifier]=notifier
    [inference]=inference [lstm]=inference [acting]=acting [update]=update [worlds]='' [whole]='')
[ $# -gt 0 ] || set -- roofline lander highway steakhouse notifier inference lstm acting update worlds whole
for part in "$@"; do
    if [ -z "${bench_of[$part]+known}" ]; then
        echo "there is no part \`$part\`" >&2
        usage >&2
        exit 2
    fi
done

[ -z "${LEADTIME:-}" ] || LEADTIME=$(realpath "$LEADTIME")
cd "$(dirname "$0")/.."
# Before the number of threads is set, which would be the answer.
n_cores=$(nproc)
python=${PYTHON:-python3}
sf_python=${SF_PYTHON:-$python}
# More threads make networks as small as these slower.
export OMP_NUM_THREADS=1 MKL_NUM_THREADS=1
one_core=(taskset -c 0)
two_cores=()
[ "$n_cores" -le 2 ] || two_cores=(taskset -c 0,1)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# Builds everything that the parts need before the first is measured, on all cores.
build() {
    local part
    local -A wanted=()
    for part in "$@"; do
        if [ -n "${bench_of[$part]}" ]; then wanted[${bench_of[$part]}]=1; fi
        if [ "$part" = whole ] && [ -z "${LEADTIME:-}" ]; then
            cargo build --release --quiet --locked
            LEADTIME=${CARGO_TARGET_DIR:-target}/release/leadtime
        fi
    done
    if [ ${#wanted[@]} -gt 0 ]; then
        cargo bench --no-run --quiet --locked --workspace $(printf -- '--bench %s ' "${!wanted[@]}")
    fi
}

# ours BENCH [FILTER]: prints a line per bench, and the shares that the bench itself prints. `cores` is a command before it, if any.
cores=("${one_core[@]}")
ours() {
    rm -rf "$work/criterion"
    if ! env CRITERION_HOME="$work/criterion" ${cores[@]+"${cores[@]}"} cargo bench --quiet --locked --workspace --bench "$1" -- \
        --noplot --warm-up-time 1 --measurement-time 3 --sample-size 30 ${2+"$2"} >"$work/said" 2>"$work/errors"; then
        cat "$work/errors" >&2
        return 1
    fi
    python3 bench/rates.py benches "$work/criterion"
    grep '^share of' "$work/said" || true
}

# peer SCRIPT [ARGUMENT...]
peer() { ${cores[@]+"${cores[@]}"} "$python" "$@" || echo "skipped: $1 failed"; }

# whole NAME OPTION...: notes the rate of a run of ours.
whole() {
    local name=$1 rate
    shift
    rm -rf "$work/runs"
    if ${two_cores[@]+"${two_cores[@]}"} "$LEADTIME" up "$@" --steps 1e6 --set evaluation.during_training=0 \
        --runs "$work/runs" --name run </dev/null >"$work/said" 2>&1; then
        rate=$(python3 bench/rates.py run "$work/runs/run/metrics.jsonl")
        [ -z "$rate" ] || printf '%s\t%s\n' "$name" "$rate" >>"$work/rates"
    else
        echo "failed: leadtime up $*"
        tail -n 3 "$work/said"
    fi
}

# whole_peer NAME INTERPRETER SCRIPT: notes the rate of a peer; one that says none is not asked again.
declare -A without=()
whole_peer() {
    [ -z "${without[$1]:-}" ] || return 0
    local said rate
    said=$(${two_cores[@]+"${two_cores[@]}"} "$2" "$3" "$seconds" 2>"$work/errors" </dev/null | grep -E '^(\{|skipped)' | tail -n 1) || true
    rate=$(sed -n 's/.*"steps_per_second": \([0-9.]*\).*/\1/p' <<<"$said")
    if [ -n "$rate" ]; then
        printf '%s\t%s\n' "$1" "$rate" >>"$work/rates"
    else
        without[$1]=1
        echo "$1: ${said:-skipped: $(tail -n 1 "$work/errors")}"
    fi
}

part_roofline() { ours roofline; }
part_lander() {
    ours lander
    peer bench/peers/lander_gymnasium.py
}
part_highway() {
    ours highway
    peer bench/peers/highway.py
}
part_steakhouse() {
    ours steakhouse
    peer bench/peers/steakhouse.py
}
part_notifier() { ours notifier; }
part_inference() {
    ours inference '^inference(/| with ego attention/)'
    peer bench/peers/ppo_torch.py inference
}
part_lstm() {
    ours inference '^inference with lstm/'
    peer bench/peers/ppo_torch.py lstm
}
part_acting() { ours acting; }
part_update() {
    # Two threads on one core would be slower than one; the peer has one thread anyway.
    local cores=()
    ours update
    peer bench/peers/ppo_torch.py update
}
part_worlds() { peer bench/python_worlds.py; }
part_whole() {
    local small=(--set learner.n_envs=4 --set learner.n_steps=128 --set learner.n_minibatches=4 --set learner.n_epochs=4)
    local round
    : >"$work/rates"
    for round in $(seq "$rounds"); do
        whole "pilot task" -c pilot --actors 1 "${small[@]}"
        whole_peer "pilot task, CleanRL-style PPO" "$python" bench/peers/whole_cleanrl_style.py
        whole_peer "pilot task, Sample Factory" "$sf_python" bench/peers/whole_sample_factory.py
        whole "up -c lander --actors 1" -c lander --actors 1
        whole "up -c lander --actors 2" -c lander --actors 2
        whole "up -c highway --actors 2" -c highway --actors 2
        whole "up -c steakhouse --actors 1" -c steakhouse --actors 1
    done
    python3 bench/rates.py rounds "$work/rates"
}

build "$@"
declare -A unit=([roofline]='operations/s, bytes/s' [lander]='frames/s' [highway]='frames/s' [steakhouse]='steps/s' [notifier]='steps/s'
    [inference]='observations/s' [lstm]='observations/s' [acting]='steps/s' [update]='samples/s' [worlds]='steps/s of CPU time'
    [whole]='steps/s on two cores')
echo "$n_cores cores,$(sed -n 's/^model name[^:]*://p' /proc/cpuinfo | head -n 1), load $(cut -d ' ' -f 1-3 /proc/loadavg)"
for part in "$@"; do
    echo "== $part, ${unit[$part]}"
    "part_$part"
done
