# Sourced by the scripts beside it that are told a board.

# read_board_options "OPTION..." ARGUMENT...: sets architecture, triplet, loader and emulator, and for each --OPTION VALUE
# the variable of that name. Ends the script with 2 when asked for something unknown.
read_board_options() {
  local known=" $1 "
  shift
  architecture=""
  while (($# > 0)); do
    case "$1" in
      arm64 | armhf | armel) architecture=$1 ;;
      *)
        if [[ "$1" != --* || "$known" != *" ${1#--} "* ]]; then
          echo "error: $1 is neither arm64, armhf nor armel, nor an option; see --help" >&2
          exit 2
        elif [[ -z "${2:-}" ]]; then
          echo "error: $1 needs a value; see --help" >&2
          exit 2
        fi
        printf -v "${1#--}" %s "$2"
        shift
        ;;
    esac
    shift
  done
  case "$architecture" in
    arm64) triplet=aarch64-linux-gnu loader=ld-linux-aarch64.so.1 emulator=qemu-aarch64 ;;
    armhf) triplet=arm-linux-gnueabihf loader=ld-linux-armhf.so.3 emulator=qemu-arm ;;
    armel) triplet=arm-linux-gnueabi loader=ld-linux.so.3 emulator=qemu-arm ;;
    *)
      echo "error: which board? arm64, armhf or armel; see --help" >&2
      exit 2
      ;;
  esac
}
