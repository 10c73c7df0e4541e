# Unity and littlefs: the folder the user names, or the pinned package (tools/fetch_deps.py).
function(tailbeat_dependency name variable)
  set(dir "${${variable}}")
  if(NOT dir)
    set(dir "$ENV{${variable}}")
  endif()
  if(NOT dir AND EXISTS ${TAILBEAT_CARRIED}/deps/${name})
    set(dir ${TAILBEAT_CARRIED}/deps/${name})
  endif()
  if(NOT dir)
    set(dir ${TAILBEAT_FETCHED_DIR}/deps/${name})
    execute_process(
      COMMAND ${Python_EXECUTABLE} ${PROJECT_SOURCE_DIR}/tools/fetch_deps.py
              --into ${TAILBEAT_FETCHED_DIR}/deps ${name}
      RESULT_VARIABLE failed)
    if(failed)
      message(FATAL_ERROR "${name} could not be fetched. Set ${variable} to a folder that holds it.")
    endif()
  endif()
  set(${variable}_FOUND ${dir} PARENT_SCOPE)
endfunction()

tailbeat_dependency(littlefs LITTLEFS_DIR)
set(LITTLEFS_DIR ${LITTLEFS_DIR_FOUND})
if(TAILBEAT_TESTS OR TAILBEAT_SELFTEST)
  tailbeat_dependency(unity UNITY_DIR)
  set(UNITY_DIR ${UNITY_DIR_FOUND})
endif()
