#!/bin/sh
# Tests of scripts/farm: the job files that it writes, and the arguments that it refuses. Further tests run pictures and
# bakes in parts on a Slurm cluster of two nodes on this machine, which the tests start and end. They kill nodes and
# processes, and run parts that always fail.
set -u
export LC_ALL=C
cd "$(dirname "$0")/.." || exit 1
. tests/support/check.sh
here=$PWD
farm=$here/scripts/farm
scene=$folder/room.obj
cp examples/scenes/two_rooms.obj "$scene"
cp examples/scenes/two_rooms.mtl "$folder/" 2> /dev/null
scripts/build sbl_render sbl_bake sbl_merge > "$folder/log" 2>&1 || { cat "$folder/log"; exit 1; }
small='--size 160x120 --preset draft --max-bounce-cells 2048'
grid='--probes 4x2x4 --preset draft --max-bounce-cells 2048'
map='--lightmap 96 --preset draft --max-bounce-cells 1024 --gutter 4'
# map_scene FILE: writes a scene with lightmap coordinates: a floor below a lamp
map_scene() {
    python3 - "$1" << 'END'
import base64, json, struct, sys
quads = [[-2, 0, -2, -2, 0, 2, 2, 0, 2, 2, 0, -2], [-.5, 2, -.5, .5, 2, -.5, .5, 2, .5, -.5, 2, .5]]
charts = [[.1, .1, .1, .6, .6, .6, .6, .1], [.7, .7, .7, .9, .9, .9, .9, .7]]
data = struct.pack('<6I', 0, 1, 2, 0, 2, 3) + b''.join(
    struct.pack('<28f', *quads[i], *charts[i], *charts[i]) for i in (0, 1))
views = [{'buffer': 0, 'byteOffset': 0, 'byteLength': 24}]
parts = [{'bufferView': 0, 'componentType': 5125, 'count': 6, 'type': 'SCALAR'}]
for i in (0, 1):
    for k, (at, size) in enumerate(((0, 48), (48, 32), (80, 32))):
        parts.append({'bufferView': len(views), 'componentType': 5126, 'count': 4, 'type': 'VEC2' if k else 'VEC3'})
        if not k:
            parts[-1].update(min=[min(quads[i][j::3]) for j in range(3)],
                             max=[max(quads[i][j::3]) for j in range(3)])
        views.append({'buffer': 0, 'byteOffset': 24 + 112 * i + at, 'byteLength': size})
meshes = [{'primitives': [{'attributes': {'POSITION': 1 + 3 * i, 'TEXCOORD_0': 2 + 3 * i, 'TEXCOORD_1': 3 + 3 * i},
                           'indices': 0, 'material': i}]} for i in (0, 1)]
json.dump({'asset': {'version': '2.0'}, 'scene': 0, 'scenes': [{'nodes': [0, 1]}], 'nodes': [{'mesh': 0}, {'mesh': 1}],
           'meshes': meshes, 'materials': [{}, {'emissiveFactor': [1, 1, 1]}], 'accessors': parts, 'bufferViews': views,
           'buffers': [{'byteLength': len(data), 'uri': 'data:application/octet-stream;base64,' +
                        base64.b64encode(data).decode()}]}, open(sys.argv[1], 'w'))
END
}

# >>job files

dry_run() {
    "$farm" render "$scene" -o "$folder/dry.png" --parts 12 --memory 3G --time 1:30:00 --sbatch=--partition=night \
        --seed 5 --dry-run > "$folder/out" || return
    for line in '^#SBATCH --mem=3G$' '^#SBATCH --time=1:30:00$' '^#SBATCH --requeue' '^#SBATCH --partition=night$' \
        '--channel=display' "'--seed' '5'" '--memory=2457M' '--part=auto/12' 'would submit: part 1; then parts 2-12'; do
        grep -q -e "$line" "$folder/out" || { echo "missing: $line"; cat "$folder/out"; return 1; }
    done
    [ ! -e "$folder/dry.png" ]
}
# a bake has no plan, and its parts have no --resume; there is a first part only with bounced light
dry_run_of_a_bake() {
    "$farm" bake "$scene" $grid -o "$folder/dry.json" --parts 8 --seed 5 --dry-run > "$folder/out" || return
    for line in '^#SBATCH --requeue' "'--probes' '4x2x4'" "'--seed' '5'" "--store=$folder/dry.json.farm/light" \
        '--part=auto/8' 'parts/%05d.json' 'would submit: part 1; then parts 2-8'; do
        grep -q -e "$line" "$folder/out" || { echo "missing: $line"; cat "$folder/out"; return 1; }
    done
    ! grep -e --plan -e --resume -e --channel "$folder/out" || return
    "$farm" bake "$scene" --vertices --mode direct -o "$folder/dry.ply" --parts 4 --dry-run > "$folder/out" &&
        grep -q 'would submit: part none; then parts 1-4' "$folder/out" && grep -q 'parts/%05d.ply' "$folder/out" &&
        ! grep -e --store "$folder/out" && [ ! -e "$folder/dry.ply" ]
}
# a lightmap has a plan, like a picture, and sbl_bake joins its parts
dry_run_of_a_lightmap() {
    "$farm" bake "$scene" $map -o "$folder/dry.map" --parts 8 --dry-run > "$folder/out" || return
    for line in "--plan=$folder/dry.map.farm/plan" "--store=$folder/dry.map.farm/light" --resume 'parts/%05d.exr' \
        "sbl_bake' .*'--lightmap' '96' .*'--gutter' '4' .*'--join=$folder/dry.map.farm/parts' -o '$folder/dry.map'" \
        'would submit: part 1; then parts 2-8'; do
        grep -q -e "$line" "$folder/out" || { echo "missing: $line"; cat "$folder/out"; return 1; }
    done
}
# the folder of a lightmap may be given with a slash at the end, and its parts are beside the folder
dry_run_beside_a_folder() {
    "$farm" bake "$scene" $map -o "$folder/slash/" --parts 8 --memory 4G --dry-run > "$folder/out" &&
        [ -d "$folder/slash.farm/parts" ] && [ ! -e "$folder/slash" ] && grep -q -e '--memory=3276M' "$folder/out" &&
        "$farm" --resume "$folder/slash/" --dry-run | grep -q 'would submit: part 1; then parts 2-8' &&
        "$farm" bake "$scene" --help | grep -q '^usage'
}
# a shell reads the names in the job files correctly, also if they contain spaces and quotes
names_are_quoted() {
    odd="$folder/it's an odd name"
    mkdir -p "$odd" && cp "$scene" "$odd/a room.obj" &&
        "$farm" render "$odd/a room.obj" -o "$odd/the picture.exr" $small --mode direct --parts 2 --dry-run \
            > /dev/null &&
        SLURM_ARRAY_TASK_ID=1 sh "$odd/the picture.exr.farm/parts.sbatch" &&
        SLURM_ARRAY_TASK_ID=2 sh "$odd/the picture.exr.farm/parts.sbatch" &&
        sh "$odd/the picture.exr.farm/merge.sbatch" && [ -s "$odd/the picture.exr" ]
}
# refuses STATUS WORDS ARGUMENTS...: the call must fail with this status and a message that contains the words
refuses() {
    status=$1 words=$2 got=0
    shift 2
    "$farm" "$@" > "$folder/out" 2>&1 || got=$?
    [ $got = "$status" ] && grep -q -e "$words" "$folder/out" || { echo "status $got:"; cat "$folder/out"; return 1; }
}
wrong_usage() {
    refuses 2 usage && refuses 2 'must be render' paint &&
        refuses 2 'must be followed by a scene' render "$folder/none.obj" -o x.png --parts 2 &&
        refuses 2 'o FILE is missing' render "$scene" --parts 2 && refuses 2 'parts must be' render "$scene" -o x.png &&
        refuses 2 'parts must be' render "$scene" -o x.png --parts 0 &&
        refuses 2 'parts must be' render "$scene" -o x.png --parts 10001 &&
        refuses 2 'must end in' render "$scene" -o x.jpg --parts 2 &&
        refuses 2 'does not take --join' bake "$scene" --lightmap 64 -o x --parts 2 --join y &&
        refuses 2 'needs --lightmap, --probes or --vertices' bake "$scene" -o x.json --parts 2 &&
        refuses 2 'must end in .json' bake "$scene" --probes 2x2x2 -o x.ply --parts 2 &&
        refuses 2 'memory 4X: the value must be a size' render "$scene" -o x.png --parts 2 --memory 4X &&
        refuses 2 'makes one of them' bake "$scene" --vertices --probes 2x2x2 -o x.json --parts 2 &&
        refuses 2 'must end in .ply' bake "$scene" --vertices -o x.gltf --parts 2 &&
        refuses 2 'does not take --stats' bake "$scene" --vertices -o x.ply --parts 2 --stats y &&
        refuses 2 'does not take --window' render "$scene" -o x.png --parts 2 --window 0,0,1,1 &&
        refuses 1 'not a folder of farm' --resume "$folder/none.png" &&
        refuses 1 'goes on with it' render "$scene" -o "$folder/dry.png" --parts 2
}
check dry_run dry_run
check dry_run_of_a_bake dry_run_of_a_bake
check dry_run_of_a_lightmap dry_run_of_a_lightmap
check dry_run_beside_a_folder dry_run_beside_a_folder
check names_are_quoted names_are_quoted
check wrong_usage wrong_usage
# The model of a farm with 64 parts of 1000 s without common work: each worker adds speed, up to one worker per part. If
# all work is common, one worker is best.
model_of_a_farm() {
    { printf '0\n0\n0\n'; yes 1000 | head -n 64; } > "$folder/even.times"
    scripts/bench_farm "$folder/even.times" --size 100000x100000 --startup 0 > "$folder/out" &&
        grep -q 'mean 1000.00 s, slowest / mean 1.00' "$folder/out" && awk -F '|' '
            /hours of work/ { table++ }
            table == 1 && $2 + 0 > 1 { rows++; if ($6 + 0 < 80 || $6 + 0 > 100) bad = bad $0 "\n" }
            END { printf "%s", bad; exit bad != "" || rows != 6 }' "$folder/out" || { cat "$folder/out"; return 1; }
    { printf '0\n1000\n0\n'; yes 1000 | head -n 64; } > "$folder/alike.times"
    scripts/bench_farm "$folder/alike.times" --startup 0 > "$folder/out" && grep -q '^| 1000 | 1 |' "$folder/out"
}
check model_of_a_farm model_of_a_farm

# >>Slurm

why=
for program in slurmctld slurmd sbatch squeue scontrol munged; do
    command -v $program > /dev/null || why="$program is not installed"
done
[ "$(id -u)" = 0 ] || why='only root can start it'
processes=
end_slurm() {
    for file in "$folder"/slurm/*.pid; do
        [ ! -s "$file" ] || kill "$(cat "$file")" 2> /dev/null
    done
    for id in $processes; do kill "$id" 2> /dev/null; done
}
trap 'end_slurm; sleep 1; rm -rf "$folder"' EXIT
trap 'exit 1' HUP INT TERM  # if the test is stopped, Slurm ends, too
slurm=$folder/slurm
export SLURM_CONF="$slurm/slurm.conf"
start_node() { slurmd -f "$SLURM_CONF" -N "$1"; }
start_slurm() {
    mkdir -p "$slurm/spool" "$slurm/state"
    host=$(hostname -s) port=$((20000 + $$ % 9000))
    cat > "$SLURM_CONF" << END
ClusterName=test
SlurmctldHost=$host
SlurmctldPort=$port
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=cred_expire=5
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
JobAcctGatherType=jobacct_gather/none
ReturnToService=2
SlurmdTimeout=5
KillWait=2
StateSaveLocation=$slurm/state
SlurmdSpoolDir=$slurm/spool/%n
SlurmctldPidFile=$slurm/slurmctld.pid
SlurmdPidFile=$slurm/slurmd.%n.pid
SlurmctldLogFile=$slurm/slurmctld.log
SlurmdLogFile=$slurm/slurmd.%n.log
SchedulerParameters=batch_sched_delay=1,sched_interval=1
NodeName=n1 NodeHostname=$host Port=$((port + 1)) CPUs=1 RealMemory=8000 State=UNKNOWN
NodeName=n2 NodeHostname=$host Port=$((port + 2)) CPUs=1 RealMemory=8000 State=UNKNOWN
PartitionName=all Nodes=n1,n2 Default=YES MaxTime=INFINITE State=UP
END
    if ! pgrep -x munged > /dev/null; then
        mkdir -p /run/munge && chown munge: /run/munge &&
            setpriv --reuid munge --regid munge --clear-groups munged && processes=$(pgrep -x munged)
    fi
    slurmctld -f "$SLURM_CONF" && start_node n1 && start_node n2 || return
    for second in 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15; do
        [ "$(sinfo -h -o %T 2> /dev/null)" = idle ] && return
        sleep 1
    done
    sinfo
    return 1
}
# wait_for COMMAND...: waits until the command succeeds, for at most ten minutes
wait_for() {
    turns=0
    until "$@"; do
        [ "$turns" -lt 3000 ] || { echo "waited in vain for: $*"; squeue; return 1; }
        turns=$((turns + 1))
        sleep 0.2
    done
}
nothing_runs() { [ -z "$(squeue -h -t pending,running,completing,configuring -o '%i %r' |
    grep -v DependencyNeverSatisfied)" ]; }
# alone FOLDER N: makes the N parts of a farm again without Slurm, with its plan and bounced light, and checks that the
# files are equal
alone() {
    k=1
    while [ "$k" -le "$2" ]; do
        part=$(printf %05d "$k")
        sed "s:$1.farm/parts/:$folder/alone.:" "$1.farm/parts.sbatch" > "$folder/alone.sh"
        SLURM_ARRAY_TASK_ID=$k sh "$folder/alone.sh" &&
            cmp "$folder/alone.$part.exr" "$1.farm/parts/$part.exr" || return
        k=$((k + 1))
    done
}
# nodes_used: prints the number of jobs that each node has started, one number per line
nodes_used() { ls "$slurm"/slurmd.n?.log | while read -r log; do grep -c 'Launching batch job' "$log"; done; }

picture_in_parts() {
    "$farm" render "$scene" -o "$folder/a.png" $small --parts 8 && wait_for nothing_runs || return
    [ -s "$folder/a.png" ] || { cat "$folder"/a.png.farm/logs/*; return 1; }
    ! nodes_used | grep -qx 0 || { echo 'only one node was used'; return 1; }
    alone "$folder/a.png" 8 &&
        build/sbl_merge "$folder/a.png.farm/parts" -o "$folder/again.png" && cmp "$folder/a.png" "$folder/again.png"
}
# a bake in parts on the cluster gives the same file as a bake without parts, and every node runs a part
bake_in_parts() {
    nodes_used > "$folder/before"
    "$farm" bake "$scene" $grid -o "$folder/p.json" --parts 8 && wait_for nothing_runs || return
    build/sbl_bake "$scene" $grid -o "$folder/whole.json" --quiet && cmp "$folder/p.json" "$folder/whole.json" ||
        { cat "$folder"/p.json.farm/logs/*; return 1; }
    ! nodes_used | paste -d ' ' "$folder/before" - | grep -qx '\(.*\) \1' || { echo 'one node was not used'; return 1; }
}
# the parts of a lightmap equal those that are made without Slurm, and they are joined to one map
map_in_parts() {
    map_scene "$folder/map.gltf" &&
        "$farm" bake "$folder/map.gltf" $map -o "$folder/m" --parts 8 && wait_for nothing_runs || return
    [ -s "$folder/m/atlas.exr" ] && [ -s "$folder/m/scene.gltf" ] || { cat "$folder"/m.farm/logs/*; return 1; }
    alone "$folder/m" 8
}
# has_parts FOLDER N: succeeds if at least N parts are finished
has_parts() { [ "$(ls "$1.farm/parts" 2> /dev/null | grep -c exr)" -ge "$2" ]; }
# a node dies with its processes, and the process of a part is killed: both parts are made again
kill_node() {
    id=$(cat "$slurm/slurmd.n2.pid")
    kill -9 "$id"
    pkill -9 -f "slurmstepd: .*n2" 2> /dev/null
    for child in $(pgrep -f 'part=auto/10' | head -n 20); do
        grep -qz SLURMD_NODENAME=n2 "/proc/$child/environ" 2> /dev/null && kill -9 "$child"
    done
}
node_and_process_die() {
    "$farm" render "$scene" -o "$folder/b.exr" $small --size 320x240 --parts 10 || return
    wait_for has_parts "$folder/b.exr" 2 || return
    kill_node
    wait_for pgrep -f 'sbl_render.*part=auto/10' > /dev/null || return
    pkill -9 -f 'build/sbl_render.*part=auto/10'
    wait_for nothing_runs
    start_node n2
    wait_for nothing_runs || return
    [ -s "$folder/b.exr" ] || { sacct 2> /dev/null; tail -n 3 "$folder"/b.exr.farm/logs/*; return 1; }
    alone "$folder/b.exr" 10
}
# if the scene disappears after the first part, the merge does not run, and the user gets a message; when the scene is
# there again, the suggested command completes the picture
fails_for_good() {
    "$farm" render "$scene" -o "$folder/c.exr" $small --parts 4 --dry-run > /dev/null &&
        SLURM_ARRAY_TASK_ID=1 sh "$folder/c.exr.farm/parts.sbatch" || return
    mv "$scene" "$scene.away"
    "$farm" --resume "$folder/c.exr" && wait_for nothing_runs || return
    [ ! -e "$folder/c.exr" ] || { echo 'the merge ran'; return 1; }
    mv "$scene.away" "$scene"
    "$farm" --resume "$folder/c.exr" > "$folder/out" && cat "$folder/out" && wait_for nothing_runs || return
    grep -q 'part 3 of 4 is missing; its log ends: sbl_render: .*room.obj' "$folder/out" && [ -s "$folder/c.exr" ] ||
        { cat "$folder"/c.exr.farm/logs/*; return 1; }
}
slurm_tests='picture_in_parts bake_in_parts map_in_parts node_and_process_die fails_for_good'
if [ -z "$why" ] && ! start_slurm > "$folder/start" 2>&1; then
    cat "$folder/start"
    why='it does not start on this machine'
fi
for name in $slurm_tests; do
    if [ -n "$why" ]; then skip $name "Slurm: $why"; else check $name $name; fi
done
report
