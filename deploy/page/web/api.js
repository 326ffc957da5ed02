// What the server is asked.

const token = new URLSearchParams(location.search).get("token");

function address(path, query = {}) {
  const all = new URLSearchParams(token ? { ...query, token } : query);
  return `./api/${path}${all.size > 0 ? `?${all}` : ""}`;
}

async function get(path, query) {
  const answer = await fetch(address(path, query));
  const body = await answer.json();
  if (!answer.ok) throw new Error(body.error);
  return body;
}

/** All runs. */
export const runs = () => get("runs");

/** What a run is. */
export const details = (id) => get(`runs/${encodeURIComponent(id)}`);

/** A run's updates from one on. */
export const updates = (id, from) => get(`runs/${encodeURIComponent(id)}/updates`, { from });

/** Calls `onruns` with every new list, `onconnection` with whether the server is there. */
export function listen(onruns, onconnection) {
  const source = new EventSource(address("events"));
  source.addEventListener("runs", (event) => onruns(JSON.parse(event.data)));
  source.addEventListener("open", () => onconnection(true));
  source.addEventListener("error", () => {
    onconnection(false);
    // A browser gives up for good when the answer is no stream of events.
    if (source.readyState === EventSource.CLOSED) setTimeout(() => listen(onruns, onconnection), 2000);
  });
}
