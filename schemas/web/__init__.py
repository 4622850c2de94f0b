"""Pages for browsers: the part that those of the gateway and of the recorder share. It knows nothing of either.

- ``address``    where browsers come: the socket, its certificate, the names that count
- ``server``     HTTP, and the headers that keep other pages out
- ``jobs``       questions to logs as processes of their own, bounded in time, memory and number
- ``log_files``  the logs of a directory: the file itself, and its report
- ``page``       files that the pages load: elements, words in English and Chinese, the look, scripts of others

All but ``address`` and ``page`` need the extra 'desk'.
"""
