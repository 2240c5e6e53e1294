#!/usr/bin/env bash
# The suite on every OpenCL runtime for CPUs that can be had, and every kernel on a simulator.
#
#   tests/runtimes.sh                              all of them
#   tests/runtimes.sh intel rusticl                some
#   tests/runtimes.sh pocl-pip -- tests/test_nlm.py -x    pytest arguments after --
#   tests/runtimes.sh rusticl -- -n auto           a process a core; where a runtime ends one, one test fails, not all
#   tests/runtimes.sh --into FOLDER ...            where environments, caches and logs go; default: in ~/.cache
#
# pocl-pip  PoCL as pip installs it          intel    Intel's CPU runtime, from pip
# pocl      PoCL as the distribution has it  rusticl  Mesa's rusticl on llvmpipe, from the distribution
# oclgrind  tests/simulator.py
#
# What pip has is installed into environments of its own; what the distribution has, by apt-get when run as root, else
# the command that it takes is printed. Each runtime is the only one that its tests see. Ends with a table; exit code 1
# if anything failed or could not be run.
set -uo pipefail
cd "$(dirname "$0")/.."

all=(pocl-pip pocl intel rusticl oclgrind)
into="${XDG_CACHE_HOME:-$HOME/.cache}/mcdenoise-runtimes"
names=()
while [ $# -gt 0 ] && [ "$1" != -- ]; do
    case "$1" in
    --into) into="${2:?--into needs a folder}" && shift ;;
    -h | --help) sed -n '2,/^set/{/^set/!p}' "$0" && exit ;;
    *)
        [[ " ${all[*]} " == *" $1 "* ]] || { echo "$1 is no runtime: choose of ${all[*]}" >&2 && exit 2; }
        names+=("$1")
        ;;
    esac
    shift
done
[ $# -gt 0 ] && shift
[ ${#names[@]} -gt 0 ] || names=("${all[@]}")
mkdir -p "$into" && into="$(cd "$into" && pwd)"

# PyOpenCL finds PoCL from pip whatever else is asked for, so the other runtimes get an environment without it.
environment() { # name
    # Without what Debian has in python3-venv, a folder is left that has Python but not pip.
    [ -x "$into/$1/bin/pip" ] || python3 -m venv "$into/$1" || return
    "$into/$1/bin/pip" install --quiet --disable-pip-version-check -e '.[test]' || return
    [ "$1" = pocl-pip ] || "$into/$1/bin/pip" uninstall --quiet --yes pocl-binary-distribution
}

package() { # name of a Debian package, a file that it installs
    compgen -G "$2" >/dev/null && return
    if [ "$(id -u)" = 0 ]; then
        apt-get update -qq && apt-get install -qq --yes --no-install-recommends "$1" >/dev/null
    fi
    compgen -G "$2" >/dev/null || { echo "not installed: apt-get install $1" && return 1; }
}

# Folder `vendors` shows the loader one runtime: the library named, or none.
vendors() { # name [library]
    rm -rf "$into/vendors-$1" && mkdir "$into/vendors-$1"
    [ $# -eq 1 ] || echo "$2" >"$into/vendors-$1/$1.icd"
}

prepare() { # name; prints why not
    case "$1" in
    pocl-pip) environment pocl-pip && vendors pocl-pip ;;
    pocl) package pocl-opencl-icd '/usr/lib/*/libpocl.so.*' && environment others && vendors pocl "$(library libpocl.so)" ;;
    rusticl)
        package mesa-opencl-icd '/usr/lib/*/libRusticlOpenCL.so.*' && environment others &&
            vendors rusticl "$(library libRusticlOpenCL.so)"
        ;;
    intel) # its own .icd file names the folder that it was built in
        environment others && "$into/others/bin/pip" install --quiet --disable-pip-version-check intel-opencl-rt \
            intel-cmplr-lib-rt && vendors intel "$into/others/lib/libintelocl.so"
        ;;
    oclgrind) package oclgrind /usr/bin/oclgrind && environment others && vendors oclgrind ;;
    esac
}

library() { # start of its name; the shortest is the one that programs are linked to
    compgen -G "/usr/lib/*/$1.*" | awk '{ print length, $0 }' | sort -n | sed -n '1s/^[0-9]* //p'
}

on() { # name, command: only this runtime is seen, and nothing that was measured or compiled with another
    local name="$1" python="$into/others/bin"
    [ "$name" = pocl-pip ] && python="$into/pocl-pip/bin"
    shift
    env -u MCDENOISE_DEVICE -u MCDENOISE_SCHEDULE PATH="$python:$PATH" OCL_ICD_VENDORS="$into/vendors-$name" \
        OCL_ICD_FILENAMES= XDG_CACHE_HOME="$into/cache-$name" LD_LIBRARY_PATH="$(own_libraries "$name")" \
        RUSTICL_ENABLE=llvmpipe PYTHONPATH=. "$@"
}

own_libraries() {
    [ "$1" = intel ] && echo "$into/others/lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}" || echo "${LD_LIBRARY_PATH:-}"
}

version='
from mcdenoise_cl.device import list_devices
(info,) = list_devices()
print(f"{info.version}, {info.driver}")
'

table=()
failed=0
for name in "${names[@]}"; do
    echo "== $name"
    log="$into/$name.log"
    if ! prepare "$name" 2>&1 | tee "$log"; then
        failed=1
        table+=("$name|-|not run: $(tail -1 "$log")")
        continue
    fi
    if [ "$name" = oclgrind ]; then
        found="$(oclgrind --version | sed -n 's/^Oclgrind //p')"
        on "$name" python tests/simulator.py 2>&1 | tee "$log"
    else
        found="$(on "$name" python -c "$version" 2>&1 | tail -1)"
        on "$name" python -m pytest -p no:cacheprovider "$@" 2>&1 | tee "$log"
    fi
    code=${PIPESTATUS[0]}
    # The last line with numbers: what a runtime prints as it ends may follow.
    result="$(grep -E '[0-9]+ (passed|failed|skipped|error)|^[0-9]+ of [0-9]+ runs' "$log" | tail -1)"
    result="${result:-$(tail -1 "$log")}"
    if [ "$code" -ne 0 ]; then
        failed=1
        result="FAILED ($code): $result"
    fi
    table+=("$name|$found|$result")
done

echo
printf '%s\n' "runtime|version|result" "${table[@]}" | awk -F'|' '{ printf "%-9s  %-62s  %s\n", $1, $2, $3 }'
exit "$failed"
