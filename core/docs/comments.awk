# Headers' comments as doxygen wants them: a comment before something is its documentation, one at the end of a line is
# that of what the line declares, the one that opens a file is the file's, and what is indented in a comment is code.
# In the pages every name of the library has to be one.
FILENAME !~ /\.h$/ {
  if (/^```/) fenced = !fenced
  if (!fenced) gsub(/pptam::[A-Za-z_:]+(\(\))?/, "@ref &")
  print
  next
}
FNR == 1 && /^\/\/ / { print "/// @file"; opening = 1 }
!/^\/\// { opening = 0 }
/^ *\/\/ ?-{4}/ { print ""; next }  # a heading
{
  if (match($0, /^ *\/\/( |$)/)) {
    indent = $0
    sub(/\/\/.*/, "", indent)
    text = substr($0, RSTART + RLENGTH)
    code = text ~ /^  +/
    gsub(/</, "\\<", text)
    if (code) gsub(/\\</, "<", text)
    print indent "/// " (code ? "    " : "") text
    next
  }
  # The end of a line of code; not within a string.
  at = match($0, /[;,{}]  ?\/\/ /)
  if (!at) at = match($0, /[A-Za-z0-9_)]  +\/\/ /)
  if (at && $0 !~ /^#/ && $0 !~ /^}/) {
    code_part = substr($0, 1, RSTART)
    rest = substr($0, RSTART + 1)
    sub(/^ *\/\/ /, "", rest)
    gsub(/</, "\\<", rest)
    print code_part "  ///< " rest
    next
  }
  print
}
