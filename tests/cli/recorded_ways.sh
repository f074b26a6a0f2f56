#!/usr/bin/env bash
# One clip of the emulated phone, recorded in the ways that people record: does it cost accuracy, and is it told where
# the file cannot know? --help says how to run it; the exit code is 0 when every way keeps its promise.
set -euo pipefail

usage() {
  cat <<'HELP'
Usage: tests/cli/recorded_ways.sh [--seeds N] [--duration SECONDS] [--ways "NAME ..."] [--work DIR] PROGRAM
Renders one clip a seed (5 of 8 s), writes it in nineteen ways with ffmpeg, runs PROGRAM replay on each and prints a
table. A way that carries what is needed must have, in the median over the seeds, at most 1.5 times the error of the
plain clip; one that does not, or that had to be mended, must come with a warning. About 5 s a run
on a desktop computer, 10 minutes in all.
HELP
}

seeds=5 duration=8 work="" program="" only=""
while (($# > 0)); do
  case "$1" in
    -h | --help) usage; exit 0 ;;
    --seeds) seeds=$2; shift ;;
    --duration) duration=$2; shift ;;
    --ways) only=$2; shift ;;
    --work) work=$2; shift ;;
    *) program=$1 ;;
  esac
  shift
done
if [[ ! -x "$program" ]]; then
  usage >&2
  exit 2
fi
program=$(realpath "$program")
if [[ -z "$work" ]]; then
  work=$(mktemp -d)
  trap 'rm -rf "$work"' EXIT
fi
mkdir -p "$work"
ff() { ffmpeg -nostdin -v error -y "$@"; }
x264=(-c:v libx264 -crf 12 -pix_fmt yuv420p)

# name | does the file carry what is needed: all; mended, when told in a warning; or not, and then told | what it is
ways=(
  "plain|all|mp4, 30 frames/s"
  "variable|all|mp4, 30 frames/s for half of the time, then 15"
  "gap|all|mp4, 0.3 s missing"
  "doubled|mended|mkv, one time stamp twice"
  "backward|mended|mkv, one time stamp earlier than the one before"
  "webm|all|webm by VP8, times in whole milliseconds"
  "mjpeg|all|avi by MJPEG"
  "ten_bit|all|mp4, 10 bits"
  "full_range|all|mp4, grey from 0 to 255"
  "turned|all|mp4, stored lying; calibrated upright, --rotate 90"
  "wide_pixels|all|mp4, stored twice as wide, and calibrated so"
  "wide_fov|mended|the same with --fov and the file's note of the pixels' shape"
  "names|all|images named by the time, decimals as needed"
  "names_ns|all|images named by nanoseconds"
  "list_ms|mended|rgb.txt with milliseconds"
  "raw_fps|all|raw H.265 and --fps 30"
  "raw|not|raw H.265, no times in the file"
  "frozen|not|mp4, one picture repeated for 0.6 s"
  "arrival|not|rgb.txt with times of arrival: frames in pairs"
)

# Makes a way's recording from the sequence in $1 and its plain clip $2 in the folder $3, and sets what replay is given,
# and where its time begins.
record() {
  local way=$1 sequence=$2 plain=$3 folder=$4
  source="$folder/$way.mp4" options=(--calibration "$sequence/calibration.yaml") origin=0
  local half=$((duration / 2)) middle=$((duration / 2 + 1))
  case "$way" in
    plain) source=$plain ;;
    variable)
      ff -i "$plain" -vf "select='lt(t,$half)+not(mod(n,2))'" -fps_mode passthrough "${x264[@]}" "$source"
      ;;
    gap) ff -i "$plain" -vf "select='lt(t,$middle)+gt(t,$middle+0.3)'" -fps_mode passthrough "${x264[@]}" "$source" ;;
    doubled | backward)
      # Without B frames and with decoding times far enough ahead, so that ffmpeg leaves the times as they are.
      source="$folder/$way.mkv"
      local other='PREV_OUTPTS'
      if [[ "$way" == backward ]]; then other='PTS-60'; fi
      ff -i "$plain" "${x264[@]}" -bf 0 "$folder/no_b.mkv"
      ff -i "$folder/no_b.mkv" -c copy -bsf:v "setts=pts=if(eq(N\,100)\,$other\,PTS):dts=DTS-200" "$source"
      ;;
    webm)
      source="$folder/$way.webm"
      ff -i "$plain" -c:v libvpx -crf 4 -b:v 8M "$source"
      ;;
    mjpeg)
      source="$folder/$way.avi"
      ff -i "$plain" -c:v mjpeg -q:v 2 -pix_fmt yuvj420p "$source"
      ;;
    ten_bit) ff -i "$plain" -c:v libx264 -crf 12 -pix_fmt yuv420p10le "$source" ;;
    full_range) ff -i "$plain" -vf scale=out_range=full -c:v libx264 -crf 12 -pix_fmt yuvj420p -color_range pc "$source" ;;
    turned)
      ff -i "$plain" -vf transpose=2 "${x264[@]}" "$folder/lying.mp4"
      ff -i "$folder/lying.mp4" -c copy -metadata:s:v rotate=-90 "$source"
      options+=(--rotate 90)
      ;;
    wide_pixels | wide_fov)
      ff -i "$plain" -vf "scale=2*iw:ih,setsar=1/2" "${x264[@]}" "$source"
      local fx fy cx cy width height
      IFS=', ' read -r fx fy cx cy <<<"$(sed -nE 's/^ *intrinsics: \[(.*)\]/\1/p' "$sequence/calibration.yaml")"
      IFS=', ' read -r width height <<<"$(sed -nE 's/^ *resolution: \[(.*)\]/\1/p' "$sequence/calibration.yaml")"
      if [[ "$way" == wide_pixels ]]; then
        options=(--calibration "$folder/wide.yaml")
        awk -v fx="$fx" -v fy="$fy" -v cx="$cx" -v cy="$cy" -v width="$width" -v height="$height" '
          /intrinsics:/ { printf "  intrinsics: [%.6f, %s, %.6f, %s]\n", 2 * fx, fy, 2 * cx + 0.5, cy; next }
          /resolution:/ { printf "  resolution: [%d, %d]\n", 2 * width, height; next }
          { print }' "$sequence/calibration.yaml" >"$folder/wide.yaml"
      else
        options=(--fov "$(awk -v fx="$fx" -v width="$width" 'BEGIN { print 360 / 3.14159265 * atan2(width / 2, fx) }')"
          --readout rows:+:0.030)
      fi
      ;;
    names | names_ns)
      source="$folder/$way" origin=1700000000
      mkdir -p "$source"
      awk -v ns=$((${#way} - 5)) -v origin=$origin '!/^#/ {
        t = sprintf("%.3f", $1); sub(/0+$/, "", t); sub(/[.]$/, ".0", t)
        split(t, part, ".")
        if (ns) print $2, origin + part[1] substr($1 "000000000", index($1, ".") + 1, 9)
        else print $2, origin + part[1] "." part[2] }' "$sequence/rgb.txt" |
        while read -r image name; do ln -sf "$sequence/$image" "$source/$name.png"; done
      ;;
    list_ms | arrival)
      source="$folder/$way"
      mkdir -p "$source"
      ln -sfn "$sequence/rgb" "$source/rgb"
      if [[ "$way" == list_ms ]]; then
        awk '!/^#/ { printf "%.4f %s\n", 1000 * $1, $2 }' "$sequence/rgb.txt" >"$source/rgb.txt"
      else
        awk '!/^#/ { printf "%.9f %s\n", $1 + (n++ % 2 ? 0 : 0.0328), $2 }' "$sequence/rgb.txt" >"$source/rgb.txt"
      fi
      ;;
    raw | raw_fps)
      source="$folder/$way.h265"
      ff -i "$plain" -c:v libx265 -crf 8 -pix_fmt yuv420p \
        -x265-params vui-timing-info=0:vui-hrd-info=0:log-level=none "$source"
      if [[ "$way" == raw_fps ]]; then options+=(--fps 30); fi
      ;;
    frozen)
      # Without loss, so that the repeated pictures are equal bit for bit.
      ff -i "$plain" -filter_complex "[0:v]split[a][b];[a][b]freezeframes=first=135:last=152:replace=134" \
        -c:v libx264 -qp 0 "$source"
      ;;
  esac
}

# Error in percent of the path, of what is compared with the truth; "-" when nothing is.
error_of() {  # trajectory truth origin way
  local shifted="$1.shifted"
  awk -v origin="$3" -v frozen="$([[ "$4" == frozen ]] && echo 1 || echo 0)" '/^#/ { next }
    { split($1, part, "."); t = sprintf("%d.%s", part[1] - origin, part[2]) }
    !(frozen && t >= 4.4 && t < 5.2) { $1 = t; print }' "$1" >"$shifted"
  "$program" eval "$shifted" "$2" 2>/dev/null | sed -nE 's/^trajectory error +([0-9.e+-]+) %.*/\1/p' | grep . || echo -
}

: >"$work/runs.txt"  # way seed error tracked% exit warnings
for ((seed = 1; seed <= seeds; ++seed)); do
  sequence="$work/$seed/sequence" plain="$work/$seed/plain.mp4"
  if [[ ! -f "$plain" ]]; then
    mkdir -p "$work/$seed"
    "$program" sim --scene desk --seed "$seed" --duration "$duration" --fps 30 --readout rows:+:0.030 --exposure 0.01 \
      --dump "$sequence" &>"$work/$seed/sim.log"
    ff -framerate 30 -pattern_type glob -i "$sequence/rgb/*.png" "${x264[@]}" "$plain"
  fi
  for entry in "${ways[@]}"; do
    way=${entry%%|*}
    if [[ -n "$only" && " plain $only " != *" $way "* ]]; then continue; fi
    record "$way" "$sequence" "$plain" "$work/$seed"
    out="$work/$seed/out_$way" log="$work/$seed/$way.log" code=0
    rm -rf "$out"
    "$program" replay "$source" "${options[@]}" --no-report --no-overlay --out "$out" >"$log" 2>&1 || code=$?
    error=-
    if [[ -s "$out/trajectory.txt" ]]; then
      error=$(error_of "$out/trajectory.txt" "$sequence/groundtruth.txt" "$origin" "$way")
    fi
    tracked=$(sed -nE 's/^tracked since then +([0-9.]+) %.*/\1/p' "$log")
    warnings=$(grep -c "warning:" "$log" || true)
    printf '%s %d %s %s %d %d\n' "$way" "$seed" "$error" "${tracked:--}" "$code" "$warnings" >>"$work/runs.txt"
    if [[ -t 2 ]]; then printf '\rseed %d, %-12s' "$seed" "$way" >&2; fi
  done
done
if [[ -t 2 ]]; then printf '\r%30s\r' "" >&2; fi

# Medians over the seeds, then the verdict.
printf '%s\n' "${ways[@]}" | awk -F'|' -v runs="$work/runs.txt" '
  function median(list, n,    i, j, t) {
    for (i = 2; i <= n; ++i) for (j = i; j > 1 && list[j - 1] > list[j]; --j) { t = list[j]; list[j] = list[j - 1]; list[j - 1] = t }
    return n % 2 ? list[(n + 1) / 2] : (list[n / 2] + list[n / 2 + 1]) / 2
  }
  BEGIN {
    while ((getline line < runs) > 0) {
      split(line, f, " ")
      way = f[1]; ++count[way]
      errors[way, count[way]] = f[3] == "-" ? 1e9 : f[3] + 0
      tracked[way, count[way]] = f[4] == "-" ? 0 : f[4] + 0
      if (f[5] != 0) bad_exit[way] = bad_exit[way] " " f[5]
      warned[way] += f[6] > 0
    }
    printf "%-12s %9s %10s %9s %7s %6s  %s\n", "way", "warned", "tracked %", "error %", "ratio", "", "what it is"
  }
  {
    way = $1; n = count[way]
    if (!n) next
    for (i = 1; i <= n; ++i) { e[i] = errors[way, i]; t[i] = tracked[way, i] }
    error = median(e, n); share = median(t, n)
    if (way == "plain") plain = error
    ratio = plain > 0 ? error / plain : 1e9
    good = !bad_exit[way] && ($2 == "not" || ratio <= 1.5) && ($2 == "all" || warned[way] == n)
    if (!good) ++failed
    printf "%-12s %5d of %d %10.1f %9s %7s %6s  %s%s\n", way, warned[way], n, share, \
      error < 1e9 ? sprintf("%.3f", error) : "none", error < 1e9 ? sprintf("%.2f", ratio) : "-", \
      good ? "good" : "FAILED", $3, bad_exit[way] ? ", exit code" bad_exit[way] : ""
  }
  END {
    print failed ? failed " ways failed" : "every way keeps its promise"
    exit failed > 0
  }'
