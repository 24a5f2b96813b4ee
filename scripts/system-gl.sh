#!/usr/bin/env bash
# OpenGL without a screen: installs what `--renderer gl` and its tests need where that takes no
# password, says what to install where it does. Never fails its caller: prtnet draws without it too.
set -u

there() { compgen -G "$1" >/dev/null; }

missing=()
{ PATH=$PATH:/usr/sbin:/sbin ldconfig -p 2>/dev/null | grep -F libEGL.so.1 >/dev/null; } ||
    missing+=(libegl1)
# Mesa's drivers, the software one among them; a vendor's own driver will do as well.
there '/usr/lib*/dri/*_dri.so' || there '/usr/lib/*/dri/*_dri.so' ||
    there '/usr/share/glvnd/egl_vendor.d/*nvidia*.json' || missing+=(libgl1-mesa-dri)
command -v Xvfb >/dev/null || missing+=(xvfb) # a screen for the viewer's tests
[ ${#missing[@]} -gt 0 ] || exit 0

sudo=()
[ "$(id -u)" = 0 ] || sudo=(sudo -n)
if command -v apt-get >/dev/null && "${sudo[@]}" true 2>/dev/null; then
    echo "Installing ${missing[*]} ..."
    apt=("${sudo[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -qq)
    "${apt[@]}" install -y --no-install-recommends "${missing[@]}" >/dev/null 2>&1 ||
        { "${apt[@]}" update && "${apt[@]}" install -y --no-install-recommends "${missing[@]}"; } \
            >/dev/null 2>&1 && exit 0
fi
echo "OpenGL is not fully set up; --renderer cpu works without. To complete it install" \
    "${missing[*]} (Debian's names), for instance: sudo apt-get install ${missing[*]}"
exit 0
