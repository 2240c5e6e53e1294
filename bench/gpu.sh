#!/usr/bin/env bash
# Tests, speed and quality on the GPU of this machine, into one file: bench/results/<device>.json.
#
#   bash bench/gpu.sh [--device NAME] [--frames FOLDER] [--quick] [--no-install]
#
# --device NAME   another device than the first GPU, for instance a CPU runtime for a dry run
# --frames FOLDER frames with references; without it those of frames.py: our own scenes, rendered, take a while
# --quick         a few tests, small frames, two rounds: to see whether everything runs
# --no-install    use the Python that is active as it is
#
# Packages go into the virtual environment that is active, else into .venv-bench. Exit code 1 if a test failed; the
# file is written all the same and says which.
set -euo pipefail
cd "$(dirname "$0")/.."

device='' quick='' install=yes frames=()
while [ $# -gt 0 ]; do
    case "$1" in
        --device) device=${2:?--device needs a name}; shift ;;
        --frames) frames=(--frames "${2:?--frames needs a folder}"); shift ;;
        --quick) quick=--quick ;;
        --no-install) install='' ;;
        -h | --help) sed -n '2,/^set/{/^#/s/^# \{0,1\}//p}' "$0"; exit 0 ;;
        *) echo "gpu.sh: $1 is no option: see bash bench/gpu.sh --help" >&2; exit 2 ;;
    esac
    shift
done

python=python3
if [ -n "$install" ]; then
    if [ -z "${VIRTUAL_ENV:-}" ]; then
        [ -x .venv-bench/bin/python ] || python3 -m venv .venv-bench
        python=.venv-bench/bin/python
    fi
    "$python" -m pip install --quiet --upgrade pip
    "$python" -m pip install --quiet -e '.[test,bench]'
fi

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# In containers the NVIDIA driver's library is often there, but not the file that tells the OpenCL loader of it.
gpu_found() { "$python" bench/gather.py device >/dev/null 2>&1; }
if [ -z "$device" ] && [ -z "${OCL_ICD_VENDORS:-}" ] && ! gpu_found; then
    mkdir "$work/vendors"
    echo libnvidia-opencl.so.1 >"$work/vendors/nvidia.icd"
    if OCL_ICD_VENDORS="$work/vendors" gpu_found; then
        export OCL_ICD_VENDORS="$work/vendors"
        echo "gpu.sh: found the NVIDIA driver by its library; the OpenCL loader was not told of it" >&2
    fi
fi
MCDENOISE_DEVICE=$("$python" bench/gather.py device ${device:+"$device"})
export MCDENOISE_DEVICE
echo "gpu.sh: measuring on $MCDENOISE_DEVICE" >&2

tests=() speed=() quality=()
if [ -n "$quick" ]; then
    tests=(tests/test_device.py tests/test_nlm.py)
    small=(--rendered --cache "$work/cache" --render-size 96 54 --reference-spp 64)
    speed=("${small[@]}" --size 160 90 --size 320 180 --rounds 2)
    quality=("${small[@]}" --spp 4 16)
fi

failed=0
"$python" -m pytest "${tests[@]}" --junitxml="$work/tests.xml" >&2 || failed=1
if [ ! -s "$work/tests.xml" ]; then
    echo "gpu.sh: the tests did not run" >&2
    exit 1
fi
"$python" bench/speed.py "${frames[@]}" "${speed[@]}" --stages --json "$work/speed.json"
"$python" bench/quality.py "${frames[@]}" "${quality[@]}" --json "$work/quality.json"
result=$("$python" bench/gather.py write --work "$work" $quick)
echo "gpu.sh: wrote $result" >&2
if [ "$failed" = 1 ]; then
    echo "gpu.sh: some tests failed; the file says which" >&2
    exit 1
fi
