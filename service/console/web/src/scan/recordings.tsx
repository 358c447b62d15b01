import { useState } from "preact/hooks";
import { api, told, type Recording } from "../net/api";
import { request } from "../net/request";
import { changes } from "../state/scans";
import { Failed, useAction } from "../ui/action";
import { useAsked } from "../ui/asked";
import { Field } from "../ui/field";
import { counted, when } from "../words/units";

const UPLOAD_S = 600;
const SHOWN = 100;

interface RecordingsProps {
  chosen: string | null;
  choose: (id: string | null) => void;
}

/** The recordings that the service has, to choose one, and the way for more to come in. */
export function Recordings({ chosen, choose }: RecordingsProps) {
  const [known, setKnown] = useState<Recording[] | null>(null);
  const upload = useAction();

  const failure = useAsked(
    () => told(api.GET("/api/recordings", { params: { query: { limit: SHOWN } } })),
    ({ recordings }) => setKnown(recordings),
    [changes.value],
  );

  async function send(file: File): Promise<void> {
    const added = await told(
      api.POST("/api/recordings", {
        params: { query: { name: file.name } },
        // The description has a body of bytes as a text.
        body: file as unknown as string,
        bodySerializer: (body: unknown) => body as BodyInit,
        headers: { "Content-Type": "application/octet-stream" },
        fetch: (asked) => request(asked, UPLOAD_S),
      }),
    );
    setKnown([added, ...(known ?? []).filter((one) => one.id !== added.id)]);
    choose(added.id);
  }

  return (
    <div class="row wide">
      <Field label="Recording" hint="recording">
        {(id) => (
          <select id={id} value={chosen ?? ""} onChange={(event) => choose(event.currentTarget.value || null)}>
            <option value="">{known?.length === 0 ? "there is none yet" : "choose one"}</option>
            {known?.map((one) => (
              <option key={one.id} value={one.id}>
                {nameOf(one)}
              </option>
            ))}
          </select>
        )}
      </Field>
      <label class="button">
        {upload.busy ? "Sending ..." : "Add a file (.mcap)"}
        <input
          type="file"
          class="unseen"
          accept=".mcap"
          disabled={upload.busy}
          onChange={(event) => {
            const [file] = event.currentTarget.files ?? [];
            event.currentTarget.value = "";
            if (file) void upload.run(() => send(file));
          }}
        />
      </label>
      <Failed failure={upload.failure ?? failure} />
    </div>
  );
}

function nameOf({ name, created_at, views, size_bytes }: Recording): string {
  const about = `${when(created_at, "medium")}, ${counted(views, "view")}, ${(size_bytes / 1e6).toFixed(1)} MB`;
  return name === null ? about : `${name}, ${about}`;
}
