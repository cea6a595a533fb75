#!/bin/sh
# From nothing to scored policies, in this folder, with carecontact and torch installed. Times are of 16 cores and one
# GPU, an H200:
#
#     sh pipeline.sh demos OUT    # 620 demonstrations, 6 minutes
#     sh pipeline.sh train OUT    # both policies, 14 minutes
#     sh pipeline.sh score OUT    # LEVELS and SEEDS (0-8), with a control, beside the blind floor
#
# Each command, given again, keeps the trials that are finished.
[ $# = 2 ] || { echo "usage: sh pipeline.sh demos|train|score OUT" >&2; exit 2; }
out=$2 rules=bathing-wide-v2
export OMP_NUM_THREADS=1
set -e
case $1 in
demos)
    for part in L0:10 L1:200 L2:100; do
        carecontact demonstrate --protocol $rules --level "${part%:*}" --persons "${part#*:}" --tasks T1,T3 \
            --noise 4mm --out "$out/demos-${part%:*}"
    done ;;
train)
    python point_flow.py prepare "$out"/demos-L? --out "$out/demos.npz"
    python bc_lowdim.py "$out"/demos-L? --out "$out/bc.npz" & cloning=$!
    python point_flow.py train "$out/demos.npz" --out "$out/point_flow.npz"
    wait $cloning ;;
score)
    score() {
        carecontact run --protocol $rules --level $level --tasks T1,T3 --seeds "${SEEDS:-0-8}" "$@"
    }
    for level in ${LEVELS:-L0 L1 L2}; do
        for control in "" "--control shuffled-look"; do
            score --policy bc_lowdim:BehaviourCloning --policy-arg weights="$out/bc.npz" --out "$out/bc-$level" $control
            score --policy learned --policy-arg weights="$out/point_flow.npz" --out "$out/flow-$level" $control
        done
        score --policy mean-person-hybrid --policy-arg person=bathing-wide-L2 --out "$out/floor-$level"
        score --policy look-and-press --out "$out/script-$level"
    done ;;
*) echo "pipeline.sh: expected demos, train or score, got $1" >&2; exit 2 ;;
esac
